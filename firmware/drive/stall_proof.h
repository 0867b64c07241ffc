/* stall_proof.h - full current and no movement: is the shaft held fast, does nobody see it move, or does the current push
 * where no torque comes of it?
 *
 * The current vector turns away from the q axis by an angle phi, first to one side and back, then to the other. Its torque
 * is proportional to cos(phi - delta), where delta is the error of the encoder's angle.
 *
 * Unseen: a rotor that is free has come to lie along a current vector whose angle has stopped changing with the encoder,
 * and is as quiet there as one that is held. It goes with the vector, and its flux across it tells (rotor_follow.h).
 *
 * Seen: with the right angle the torque is the same at phi and at -phi, and nowhere larger than where the shaft has stood.
 * So as soon as the shaft moves the vector goes to -phi. A shaft that goes on has come free, was driven by its load, or
 * has been pushed off what holds it: it was held. With a wrong angle the torque is another one there: what moved with it
 * stops, what moved against it turns round, if need be where the vector turns on. Whatever the load is, it is the same in
 * both places.
 */
#ifndef SERVO_DRIVE_STALL_PROOF_H
#define SERVO_DRIVE_STALL_PROOF_H

#include "math/frac.h"

typedef struct {
    bool runs;
    bool second; /* the vector turns to the second side */
    bool mirrored; /* the shaft has moved, and the vector has gone to the other side: .. */
    bool ahead; /* .. with the torque that was wanted, not against it */
    frac16_t phi; /* angle of the vector, from where the encoder has it */
    int32_t farthest; /* position so far in the direction of that movement */
    uint16_t ticks; /* slow ticks since */
    frac16_t inductive; /* voltage across the vector of a rotor that stays, at the current that flows */
} stall_proof_t;

struct axis;

/* Out of SPIN with i_q at its limit; the current stays as it is. */
void stall_proof_start(struct axis *axis);

/* One PWM period. */
void stall_proof_fast(struct axis *axis);

/* One slow tick; raises what is found in the end. */
void stall_proof_slow(struct axis *axis);

#endif

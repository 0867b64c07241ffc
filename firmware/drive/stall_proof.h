/* stall_proof.h - full current and no movement: is the shaft held fast, or does nobody see it move?
 *
 * A rotor that is free has come to lie along a current vector whose angle has stopped changing with the encoder, and is as
 * quiet there as one that is held. The vector turns to and fro as in the rotor search: a free rotor goes with it, and its
 * flux across the vector tells (rotor_follow.h).
 */
#ifndef SERVO_DRIVE_STALL_PROOF_H
#define SERVO_DRIVE_STALL_PROOF_H

#include "math/frac.h"

typedef struct {
    bool runs;
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

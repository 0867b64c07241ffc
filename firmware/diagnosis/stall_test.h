/* stall_test.h - full current and no movement: is the shaft held fast, does it move unseen, or does the current push where
 * no torque comes of it?
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
#ifndef SERVO_DIAGNOSIS_STALL_TEST_H
#define SERVO_DIAGNOSIS_STALL_TEST_H

#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"
#include "sensing/rotor_search.h"

typedef struct {
    bool running;
    bool second_side; /* the vector turns to the second side */
    bool mirrored; /* the shaft has moved, and the vector has gone to the other side: .. */
    bool with_torque; /* .. with the torque that was wanted, not against it */
    bool positive_torque; /* the torque that was wanted */
    frac16_t phi; /* angle of the vector, from where the encoder has it */
    int32_t origin; /* position at which it began to turn */
    int32_t farthest; /* position so far in the direction of that movement */
    uint16_t ticks; /* slow ticks since */
    frac16_t inductive; /* voltage across the vector of a rotor that stays, at the current that flows */
    frac16_t vector_angle; /* that the test asks for: angle of the d axis, with the current along q */
    rotor_follow_t follow;
} stall_test_t;

/* The shaft stands at full current, which stays as it is. */
void stall_test_start(stall_test_t *test, const rotor_search_config_t *config, const observation_t *observation);

/* One PWM period, with the voltage along the vector's d axis. */
void stall_test_add(stall_test_t *test, const rotor_search_config_t *config, frac16_t u_d);

/* One slow tick. */
void stall_test_step(stall_test_t *test, const rotor_search_config_t *config, const observation_t *observation,
                     evidence_t *evidence);

#endif

/* stall_test.h - stall test at full current without movement.
 *
 * Distinguishes: (1) blocked shaft, (2) free rotor with a dead encoder, (3) wrong encoder angle, error delta. The
 * current vector is rotated by phi to +phi_max, back, then to -phi_max.
 *
 * (2) The rotor follows the vector although the count is constant: the flux linkage across the vector changes
 * (rotor_follow.h).
 *
 * (1) The torque is proportional to cos(phi - delta); with delta = 0 it is equal at +phi and -phi and never larger than
 * at phi = 0. If the shaft moves, the vector is mirrored to -phi: if the movement continues, the shaft was blocked or
 * driven by its load.
 *
 * (3) If the movement stops or reverses, delta != 0. For movement against the torque the vector is rotated on, to the
 * largest phi. The load torque is the same at both angles and cancels.
 */
#ifndef SERVO_DIAGNOSIS_STALL_TEST_H
#define SERVO_DIAGNOSIS_STALL_TEST_H

#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"
#include "sensing/rotor_search.h"

typedef struct {
    bool running; /* the test is in progress */
    bool second_side; /* rotation to -phi_max */
    bool mirrored; /* the shaft has moved, and the vector has been mirrored */
    bool with_torque; /* the movement was in the direction of the commanded torque */
    bool positive_torque; /* sign of the commanded torque */
    frac16_t phi; /* angle of the vector relative to the q axis of the encoder, Q1.15 of pi */
    int32_t origin; /* position at the start of the rotation or of the mirrored part, encoder counts */
    int32_t farthest; /* farthest position in the direction of the movement, encoder counts */
    uint16_t ticks; /* slow ticks since the vector was mirrored */
    frac16_t inductive; /* omega L I at the present current, Q1.15 of full-scale voltage */
    frac16_t vector_angle; /* d axis of the current control, with the current on its q axis, Q1.15 of pi */
    rotor_follow_t follow;
} stall_test_t;

/* Begin with the shaft at rest at full current, which is kept. */
void stall_test_start(stall_test_t *test, const rotor_search_config_t *config, const observation_t *observation);

/* One PWM period; `u_d`: voltage on the d axis of the vector, Q1.15 of full-scale voltage. */
void stall_test_add(stall_test_t *test, const rotor_search_config_t *config, frac16_t u_d);

/* One slow tick: rotate the vector, confirm the finding. */
void stall_test_step(stall_test_t *test, const rotor_search_config_t *config, const observation_t *observation,
                     evidence_t *evidence);

#endif

/* torque_ripple.h - feed-forward current against torque ripple (cogging): a sum of harmonics of the mechanical angle.
 *
 *   i(angle) = sum of a_k sin(n_k (angle + lead speed) + phase_k)
 *
 * Extension of the reference design. The angle is extrapolated to the time at which the current acts. The phase error is
 * a part of the phase that the extrapolation adds, so a harmonic fades out while this phase is 1/8 .. 1/4 turn.
 */
#ifndef SERVO_CONTROL_TORQUE_RIPPLE_H
#define SERVO_CONTROL_TORQUE_RIPPLE_H

#include "math/frac.h"

#define RIPPLE_HARMONICS 8

typedef struct {
    uint16_t order[RIPPLE_HARMONICS]; /* periods per mechanical turn; 0: the list ends here */
    frac16_t amplitude[RIPPLE_HARMONICS]; /* of the current, Q1.15 of full scale */
    uint16_t phase[RIPPLE_HARMONICS]; /* of the current at the angle 0, 2^16 is one turn */
    frac32_t lead; /* turns at full-scale speed from the sampling of the angle until the current acts, Q1.31 */
} torque_ripple_config_t;

/* Current at an angle (2^32 is one turn) and a speed, Q1.31 of full scale. */
frac32_t torque_ripple_current(const torque_ripple_config_t *config, uint32_t angle, frac32_t speed);

#endif

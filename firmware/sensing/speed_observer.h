/* speed_observer.h - observer of the speed from encoder count and current.
 *
 * Extension of the reference design. Near standstill the M/T speed is as old as the last edge, tens of milliseconds,
 * and a speed loop with a bandwidth of tens of hertz oscillates. Luenberger observer of position x, speed v and load
 * acceleration a, in position counts and slow ticks; it integrates the acceleration by the current:
 *
 *   x = x + v + (Kt i_q / J + a) / 2,  v = v + Kt i_q / J + a               prediction
 *   x = x + l_1 e,  v = v + l_2 e,  a = a + l_3 e                           correction, e: measured minus estimated
 *
 * The count of the encoder is a quantised measurement: no correction while the estimated position is within the present
 * count, and otherwise e is the distance to it.
 */
#ifndef SERVO_SENSING_SPEED_OBSERVER_H
#define SERVO_SENSING_SPEED_OBSERVER_H

#include "math/frac.h"

/* Fraction bits of positions [position counts], speeds [per slow tick] and accelerations [per slow tick squared]. */
#define SPEED_OBSERVER_BITS 22

typedef struct {
    int32_t acceleration_per_current; /* acceleration Kt i / J at full-scale current, 22 fraction bits */
    int32_t speed_per_step;           /* speed (of full scale) at one count per slow tick, 31 fraction bits */
    int32_t step_per_speed;           /* 1 / speed_per_step, 16 fraction bits */
    gain_t l_position; /* correction of the position per count of error, poles at p, p, p: 1 - p^3 */
    gain_t l_speed; /* correction of the speed per count of error: 3/2 (1 - p)^2 (1 + p) */
    gain_t l_acceleration; /* correction of the acceleration per count of error: (1 - p)^3 */
} speed_observer_config_t;

typedef struct {
    int32_t half_count;   /* half a count of the encoder, position counts with 22 fraction bits */
    int32_t count;        /* position at the last step, position counts */
    int32_t part;         /* its fraction, 24 fraction bits */
    int32_t offset;       /* estimated position minus the measured one, 22 fraction bits */
    int32_t step;         /* estimated speed, counts per slow tick with 22 fraction bits */
    int32_t acceleration; /* estimated acceleration by load, friction and errors of nominal values, 22 fraction bits */
} speed_observer_t;

/* Initialise with position and speed, after `half_count` was set; `count`: position counts, `part`: fraction of one, 24 fraction bits. */
void speed_observer_reset(speed_observer_t *observer, const speed_observer_config_t *config, int32_t count,
                          int32_t part, frac32_t speed);

/* Bumpless change of the nominal values of motor and shaft, at the current `i_q`. */
void speed_observer_retune(speed_observer_t *observer, const speed_observer_config_t *before,
                           const speed_observer_config_t *config, frac16_t i_q);

/* One slow tick; `i_q`: current since the last step. Returns the speed. */
frac32_t speed_observer_step(speed_observer_t *observer, const speed_observer_config_t *config, int32_t count,
                             int32_t part, frac16_t i_q);

#endif

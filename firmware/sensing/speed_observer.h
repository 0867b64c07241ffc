/* speed_observer.h - speed from the position counter and the current, without the wait for an edge.
 *
 * Beyond the reference design. Near standstill the M/T method is as old as the last edge, tens of milliseconds, and a
 * speed loop of tens of hertz then hunts. The observer goes on with the torque that it knows of, and lets the counter
 * tell only what it can: as long as the estimate lies within the count that is read, there is nothing to correct.
 */
#ifndef SERVO_SENSING_SPEED_OBSERVER_H
#define SERVO_SENSING_SPEED_OBSERVER_H

#include "math/frac.h"

/* Fraction bits of positions [counts], speeds [counts per slow tick] and accelerations [counts per slow tick squared]. */
#define SPEED_OBSERVER_BITS 22

typedef struct {
    int32_t acceleration_per_current; /* Kt / J at full-scale current, 22 fraction bits */
    int32_t speed_per_step;           /* speed fraction of one count per slow tick, 31 fraction bits */
    int32_t step_per_speed;           /* its reciprocal, 16 fraction bits */
    gain_t l_position;                /* corrections per count of error: poles at p, p, p (1 - p^3, */
    gain_t l_speed;                   /* 3/2 (1 - p)^2 (1 + p), */
    gain_t l_acceleration;            /* (1 - p)^3) */
} speed_observer_config_t;

typedef struct {
    int32_t count;        /* position at the last step */
    int32_t offset;       /* estimated position less the count */
    int32_t step;         /* estimated speed */
    int32_t acceleration; /* that no current explains: load, friction, a wrong nominal value */
} speed_observer_t;

/* Start at a position with a speed known from elsewhere. */
void speed_observer_reset(speed_observer_t *observer, const speed_observer_config_t *config, int32_t count,
                          frac32_t speed);

/* Other nominal values of motor and shaft without a step of the acceleration, while `i_q` flows. */
void speed_observer_retune(speed_observer_t *observer, const speed_observer_config_t *before,
                           const speed_observer_config_t *config, frac16_t i_q);

/* One slow tick; `i_q` has flowed since the last one. Returns the speed. */
frac32_t speed_observer_step(speed_observer_t *observer, const speed_observer_config_t *config, int32_t count,
                             frac16_t i_q);

#endif

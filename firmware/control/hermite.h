/* hermite.h - cubic Hermite interpolation between two states of a shaft.
 *
 * Between positions p0 and p1 with the speeds v0 and v1 at the ends of a segment of length T, with s = t / T:
 *   p(s) = p0 + c1 s + c2 s^2 + c3 s^3,  c1 = v0 T,  c2 = 3 (p1 - p0) - 2 v0 T - v1 T,  c3 = v0 T + v1 T - 2 (p1 - p0)
 * A segment that is split at one of its own states stays the same curve.
 */
#ifndef SERVO_CONTROL_HERMITE_H
#define SERVO_CONTROL_HERMITE_H

#include "control/path_filter.h"

#define HERMITE_DURATION_MIN UINT32_C(16)        /* 1 ms */
#define HERMITE_DURATION_MAX UINT32_C(960000)    /* 60 s */
#define HERMITE_DISTANCE_MAX (INT64_C(1) << 52)  /* 2^28 counts */

typedef struct {
    path_position_t position; /* counts, 24 fraction bits */
    path_position_t step; /* speed: counts with 24 fraction bits per slow tick (8 PWM periods) */
} hermite_state_t;

typedef struct {
    path_position_t origin; /* counts at its beginning, 24 fraction bits */
    path_position_t c1, c2, c3; /* coefficients of the powers of the part that has passed; counts, 24 fraction bits */
    uint32_t duration;   /* PWM periods */
    uint32_t reciprocal; /* 2^62 / (duration 2^shift) */
    uint16_t shift; /* scaling of the reciprocal, bits */
} hermite_t;

/* The duration and the distance are within the limits above; speeds are below 2^8 counts per slow tick. */
void hermite_set(hermite_t *segment, hermite_state_t from, hermite_state_t to, uint32_t duration);

/* `elapsed` PWM periods after the beginning, at most the duration. */
path_position_t hermite_position(const hermite_t *segment, uint32_t elapsed);

/* Part of the duration that has elapsed, 30 fraction bits. */
uint32_t hermite_part(const hermite_t *segment, uint32_t elapsed);

/* Is the speed within `step_max` [per slow tick], or the acceleration within `acceleration_max` [per slow tick squared], in
 * the whole segment? Both with a sixty-fourth to spare for the rounding of who worked out the states. */
bool hermite_speed_within(const hermite_t *segment, path_position_t step_max);
bool hermite_acceleration_within(const hermite_t *segment, path_position_t acceleration_max);

/* How far the segment can be from its origin, at most: the hull of its control points. */
void hermite_reach(const hermite_t *segment, path_position_t *min, path_position_t *max);

#endif

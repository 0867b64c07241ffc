/* hermite.h - cubic Hermite interpolation between two states (position, speed) of a shaft.
 *
 * Segment of duration T with positions p0 and p1 and speeds v0 and v1 at its ends, s = t / T:
 *   p(s) = p0 + c1 s + c2 s^2 + c3 s^3,  c1 = v0 T,  c2 = 3 (p1 - p0) - 2 v0 T - v1 T,  c3 = v0 T + v1 T - 2 (p1 - p0)
 * Splitting a segment at one of its states does not change the curve.
 */
#ifndef SERVO_CONTROL_HERMITE_H
#define SERVO_CONTROL_HERMITE_H

#include "control/path_filter.h"

#define HERMITE_DURATION_MIN UINT32_C(16)        /* 1 ms */
#define HERMITE_DURATION_MAX UINT32_C(960000)    /* 60 s */
#define HERMITE_DISTANCE_MAX (INT64_C(1) << 52)  /* 2^28 counts */

typedef struct {
    path_position_t position; /* counts, 24 fraction bits */
    path_position_t step; /* speed, counts with 24 fraction bits per slow tick (8 PWM periods) */
} hermite_state_t;

typedef struct {
    path_position_t origin; /* position at the beginning, counts with 24 fraction bits */
    path_position_t c1, c2, c3; /* coefficients of s, s^2, s^3, counts with 24 fraction bits */
    uint32_t duration;   /* duration T, PWM periods */
    uint32_t reciprocal; /* 2^62 / (duration 2^shift) */
    uint16_t shift; /* scaling of the reciprocal, bits */
} hermite_t;

/* Compute the coefficients. Duration and distance must be within the limits above, speeds below 2^8 counts per slow
 * tick. */
void hermite_set(hermite_t *segment, hermite_state_t from, hermite_state_t to, uint32_t duration);

/* Position `elapsed` PWM periods after the beginning, counts with 24 fraction bits; `elapsed` <= duration. */
path_position_t hermite_position(const hermite_t *segment, uint32_t elapsed);

/* Elapsed time / duration, 30 fraction bits. */
uint32_t hermite_part(const hermite_t *segment, uint32_t elapsed);

/* True if the speed is at most `step_max` [per slow tick], or the acceleration at most `acceleration_max` [per slow
 * tick squared], in the whole segment. Tolerance 1/64, for the rounding of the states by the host. */
bool hermite_speed_within(const hermite_t *segment, path_position_t step_max);
bool hermite_acceleration_within(const hermite_t *segment, path_position_t acceleration_max);

/* Bounds of the position relative to the origin: convex hull of the control points. */
void hermite_reach(const hermite_t *segment, path_position_t *min, path_position_t *max);

#endif

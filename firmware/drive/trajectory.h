/* trajectory.h - the queue of timed points of an axis, and the curve through them. */
#ifndef SERVO_DRIVE_TRAJECTORY_H
#define SERVO_DRIVE_TRAJECTORY_H

#include "control/hermite.h"
#include "drive/path_units.h"

#define TRAJECTORY_POINTS 16U /* that wait; a power of two */
#define TRAJECTORY_PART_BITS 12

typedef struct {
    uint32_t tick; /* PWM periods since reset */
    int32_t position; /* counts */
    frac32_t speed; /* Q1.31 of full-scale speed */
    frac16_t i_q;  /* fed forward besides that for the acceleration and the friction */
    uint16_t part; /* of a count, TRAJECTORY_PART_BITS */
} trajectory_point_t;

/* Where the axis is meant to be at a slow tick. */
typedef struct {
    path_position_t position; /* counts, 24 fraction bits */
    frac16_t i_q; /* Q1.15 of full-scale current */
    bool over; /* the last point has been reached */
} trajectory_reference_t;

typedef struct {
    trajectory_point_t point[TRAJECTORY_POINTS];
    uint16_t in; /* points ever put in and taken out, modulo 65536 */
    uint16_t out; /* points taken out, the same */
    bool active; /* to `end`: `reference` is valid */
    hermite_t segment;
    uint32_t begin; /* tick of the segment's beginning */
    frac16_t i_q_begin; /* torque current of the first point, Q1.15 of full-scale current */
    path_position_t end_position; /* counts, 24 fraction bits */
    trajectory_point_t end;
    trajectory_reference_t reference; /* of the next slow tick */
    uint16_t taken; /* points since reset, modulo 65536 */
    uint16_t late;  /* points of these whose tick had passed when their turn came */
} trajectory_t;

/* Discard the queue and stop leading. */
void trajectory_clear(trajectory_t *t);

/* Points that wait. */
static inline uint16_t trajectory_waiting(const trajectory_t *t) { return (uint16_t)(t->in - t->out); }

/* Append a point; there is room. With `replace`, drop before what is not earlier than the point. */
void trajectory_put(trajectory_t *t, trajectory_point_t point, bool replace);

/* The newest point before a tick, of those that wait or lead; NULL if there is none. */
const trajectory_point_t *trajectory_before(const trajectory_t *t, uint32_t tick);

/* Work out the reference of the slow tick `tick`. `present` is that of the slow tick before, where a curve begins that
 * continues no other. */
void trajectory_step(trajectory_t *t, const axis_config_t *config, hermite_state_t present, uint32_t tick);

/* Position of a point, the short way round from `near`. */
path_position_t trajectory_position(const trajectory_point_t *point, path_position_t near);

#endif

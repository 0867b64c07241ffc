/* trajectory.h - queue of timed points of an axis, and their interpolation (hermite.h). */
#ifndef SERVO_DRIVE_TRAJECTORY_H
#define SERVO_DRIVE_TRAJECTORY_H

#include "control/hermite.h"
#include "drive/path_units.h"

#define TRAJECTORY_POINTS 16U /* size of the queue, a power of two */
#define TRAJECTORY_PART_BITS 12

typedef struct {
    uint32_t tick; /* time, PWM periods since reset */
    int32_t position; /* counts */
    frac32_t speed; /* Q1.31 of full-scale speed */
    frac16_t i_q;  /* additional feed-forward, besides acceleration and friction, Q1.15 of full-scale current */
    uint16_t part; /* fraction of a count, TRAJECTORY_PART_BITS fraction bits */
} trajectory_point_t;

/* Set-points at a slow tick. */
typedef struct {
    path_position_t position; /* counts with 24 fraction bits */
    frac16_t i_q; /* Q1.15 of full-scale current */
    bool over; /* the last point has been reached */
} trajectory_reference_t;

typedef struct {
    trajectory_point_t point[TRAJECTORY_POINTS];
    uint16_t in; /* write index of the queue, modulo 65536 */
    uint16_t out; /* read index of the queue, modulo 65536 */
    bool active; /* a segment to `end` is in progress, `reference` is valid */
    hermite_t segment; /* segment in progress */
    uint32_t begin; /* start of the segment, PWM periods since reset */
    frac16_t i_q_begin; /* additional feed-forward at the start of the segment, Q1.15 of full-scale current */
    path_position_t end_position; /* position of `end`, counts with 24 fraction bits */
    trajectory_point_t end; /* end point of the segment */
    trajectory_reference_t reference; /* set-points of the next slow tick */
    uint16_t taken; /* accepted points since reset, modulo 65536 */
    uint16_t late; /* points that were too late when their segment should have begun, modulo 65536 */
} trajectory_t;

/* Discard the queue and the segment in progress. */
void trajectory_clear(trajectory_t *t);

/* Number of queued points. */
static inline uint16_t trajectory_waiting(const trajectory_t *t) { return (uint16_t)(t->in - t->out); }

/* Append a point; the queue must have room. `replace`: first remove all points that are not earlier. */
void trajectory_put(trajectory_t *t, trajectory_point_t point, bool replace);

/* Newest point before a tick, queued or `end`; NULL if there is none. */
const trajectory_point_t *trajectory_before(const trajectory_t *t, uint32_t tick);

/* Compute the reference of the slow tick `tick`. `present`: state at the previous slow tick, start of a segment that
 * does not continue another one. */
void trajectory_step(trajectory_t *t, const axis_config_t *config, hermite_state_t present, uint32_t tick);

/* Position of a point, nearest to `near` modulo 2^32 counts; counts with 24 fraction bits. */
path_position_t trajectory_position(const trajectory_point_t *point, path_position_t near);

#endif

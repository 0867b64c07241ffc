/* mt_speed.h - speed by the M/T method, plain or enhanced (DRM 2.4.4..2.4.6, E33, F17..F19).
 *
 *   omega_m = 2 pi M1 f_timer / (N M2)    M1: counts and M2: time between two captured edges,
 *                                         N: counts per turn, f_timer: BOARD_TIMER_CLOCK_HZ
 */
#ifndef SERVO_SENSING_MT_SPEED_H
#define SERVO_SENSING_MT_SPEED_H

#include "hal/hal.h"
#include "sensing/encoder.h"

typedef struct {
    uint32_t speed_per_ratio; /* speed at one count per timer tick / full-scale speed, 16 fraction bits (E33) */
} mt_speed_config_t;

typedef struct {
    edge_capture_t last; /* count and time of the last captured edge */
    bool primed;         /* `last` is valid: the timer has not overflowed since */
    bool fresh;          /* an edge was captured since the last slow loop */
    uint16_t interval;   /* M2 of the last speed: time between edges, ticks of the timer */
    uint32_t waited;     /* age of the last edge at the last slow loop without a new one, ticks of the timer */
    frac32_t edge_speed; /* speed between the last two captured edges, Q1.31 of full-scale speed */
    frac32_t speed;      /* measured speed, Q1.31 of full-scale speed */
} mt_speed_t;

void mt_speed_reset(mt_speed_t *mt);

/* Process a captured B edge. */
void mt_speed_edge(mt_speed_t *mt, const mt_speed_config_t *config, const encoder_config_t *encoder,
                   edge_capture_t capture);

/* One slow loop, before the next edge is armed; `age`: time since the last captured edge (hal_edge_age). Enhanced
 * method: the interval is extended to `age` (F19), so omega_m decays as M2 / age; plain method: the speed is constant
 * until the timer overflows (F18). */
void mt_speed_slow(mt_speed_t *mt, uint32_t age, bool enhanced);

#endif

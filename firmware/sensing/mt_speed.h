/* mt_speed.h - speed by the M/T method, plain or enhanced (DRM 2.4.4..2.4.6, E33, F17..F19). */
#ifndef SERVO_SENSING_MT_SPEED_H
#define SERVO_SENSING_MT_SPEED_H

#include "hal/hal.h"
#include "sensing/encoder.h"

typedef struct {
    uint32_t speed_per_ratio; /* speed at one count per timer tick over full-scale speed, 16 fraction bits (E33) */
} mt_speed_config_t;

typedef struct {
    edge_capture_t last; /* M1(n-1), M2(n-1) as latched */
    bool primed;         /* `last` is young enough to measure from */
    bool fresh;          /* an edge was latched since the last slow loop */
    uint16_t interval;   /* M2 of the last speed */
    uint32_t waited;     /* age of the last edge at the last slow loop that saw no new one */
    frac32_t edge_speed; /* speed between the last two latched edges */
    frac32_t speed;      /* the result */
} mt_speed_t;

void mt_speed_reset(mt_speed_t *mt);

/* A B edge was latched. */
void mt_speed_edge(mt_speed_t *mt, const mt_speed_config_t *config, const encoder_config_t *encoder,
                   edge_capture_t capture);

/* Slow loop, before the next edge is armed; `age` is the time since the last latched edge (hal_edge_age). The enhanced
 * method stretches the interval to it (F19); the plain one keeps its speed until the timer has run out (F18). */
void mt_speed_slow(mt_speed_t *mt, uint32_t age, bool enhanced);

#endif

/* heat_watch.h - temperature of a heat sink, with hysteresis.
 *
 * The sensor's code is compared with codes: what curve it has (linear, or an NTC in a divider, whose code falls) is the
 * business of the tool that works them out.
 */
#ifndef SERVO_DRIVE_HEAT_WATCH_H
#define SERVO_DRIVE_HEAT_WATCH_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint16_t hot;  /* code at the limit */
    uint16_t cool; /* code below which it is over; larger than `hot` for a sensor whose code falls */
} heat_watch_config_t;

typedef struct {
    uint16_t ticks; /* slow ticks at or beyond the limit */
    bool hot;
} heat_watch_t;

void heat_watch_start(heat_watch_t *watch);

/* One slow tick. */
void heat_watch_step(heat_watch_t *watch, const heat_watch_config_t *config, uint16_t code);

#endif

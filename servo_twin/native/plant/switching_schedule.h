/* switching_schedule.h - clocks of the switching plant: event queue and next event.
 * Internal: only the files switching* include it.
 */
#ifndef PLANT_SWITCHING_SCHEDULE_H
#define PLANT_SWITCHING_SCHEDULE_H

#include "plant/switching.h"

#define CLOCK (1.0 / SWITCHING_CLOCK_HZ) /* [s] */
#define SHAFT_STEP (SWITCHING_SHAFT * CLOCK) /* [s] */
#define NEVER UINT64_MAX

static inline double seconds(uint64_t from, uint64_t to) { return (double)(int64_t)(to - from) * CLOCK; }

static inline uint64_t earlier(uint64_t x, uint64_t y) { return (x < y) ? x : y; }

/* First clock after `time` seconds from `clock`, and later than `last`. */
static inline uint64_t clock_after(uint64_t clock, double time, uint64_t last)
{
    const uint64_t at = clock + (uint64_t)(int64_t)(time * SWITCHING_CLOCK_HZ) + 1u;
    return (at > last) ? at : last + 1u;
}

static inline void queue_event(switching_t *plant, switching_event_t event)
{
    if (plant->pending < SWITCHING_EVENTS) {
        plant->event[(plant->first + plant->pending++) % SWITCHING_EVENTS] = event;
    }
}

/* Next event of an axis, from its clocks. */
static inline void update_axis_clock(switching_axis_t *axis)
{
    axis->next_clock = earlier(earlier(axis->report_clock, axis->trip_clock), axis->clock + SWITCHING_HORIZON);
}

/* Next event of the plant, from those of the axes and the others. */
static inline void update_next(switching_t *plant)
{
    plant->next = earlier(plant->other_clock, earlier(plant->axis[0].next_clock, plant->axis[1].next_clock));
}

/* Next window, shaft step, end of a short, disturbance or slip. */
void switching_update_other_clock(switching_t *plant);

#endif

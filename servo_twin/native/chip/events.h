/* events.h - the event queue: when the next event of each source is, and the function that handles it.
 *
 * Events are handled by clock, and at one clock in the order of their sources. Both are in one number, the key: clock times
 * EVENT_SOURCES plus source. The smallest key is the next event. Clocks have 60 bits then, more than three centuries; the key of
 * CHIP_NEVER stays behind all of them. The smallest key of each group of sources is kept, so that a change costs a few comparisons;
 * the first EVENT_FREQUENT groups change most often.
 */
#ifndef CHIP_EVENTS_H
#define CHIP_EVENTS_H

#include <stdint.h>

#define CHIP_NEVER UINT64_MAX /* clock of an event that is not planned */

#define EVENT_SOURCES 16u
#define EVENT_GROUP 4u /* sources 4k to 4k + 3 */
#define EVENT_GROUPS (EVENT_SOURCES / EVENT_GROUP)
#define EVENT_FREQUENT 2u
#define EVENT_KEY(clock, source) ((uint64_t)(clock) * EVENT_SOURCES + (source))
#define EVENT_CLOCK(key) ((key) / EVENT_SOURCES)
#define EVENT_SOURCE(key) ((unsigned)((key) % EVENT_SOURCES))

typedef struct {
    void (*handle)(void *peripheral, unsigned source); /* the present clock is that of the event */
    void *peripheral;
} event_handler_t;

typedef struct {
    uint64_t key[EVENT_SOURCES];  /* key of the next event of each source */
    uint64_t first[EVENT_GROUPS]; /* smallest key of each group */
    uint64_t first_rare;          /* smallest key of the groups behind the frequent ones */
    event_handler_t handler[EVENT_SOURCES];
} events_t;

static inline uint64_t events_earlier(uint64_t a, uint64_t b) { return (a < b) ? a : b; }

/* Clock of the next event of a source; CHIP_NEVER cancels it. Only the other keys of the group are read: reading the one just
 * written would wait for the write. */
static inline void events_plan(events_t *events, unsigned source, uint64_t clock)
{
    static const uint64_t self[EVENT_GROUP][EVENT_GROUP] = {
        {UINT64_MAX, 0, 0, 0}, {0, UINT64_MAX, 0, 0}, {0, 0, UINT64_MAX, 0}, {0, 0, 0, UINT64_MAX}};
    const unsigned group = source / EVENT_GROUP;
    const uint64_t *mask = self[source % EVENT_GROUP];
    const uint64_t *key = &events->key[EVENT_GROUP * group];
    const uint64_t others = events_earlier(events_earlier(key[0] | mask[0], key[1] | mask[1]),
                                           events_earlier(key[2] | mask[2], key[3] | mask[3]));
    events->key[source] = EVENT_KEY(clock, source);
    events->first[group] = events_earlier(EVENT_KEY(clock, source), others);
    if (group >= EVENT_FREQUENT) {
        events->first_rare = events_earlier(events->first[2], events->first[3]);
    }
}

/* The same in two steps, for several changes in one frequent group: each change, then once the smallest key. */
static inline void events_set(events_t *events, unsigned source, uint64_t clock)
{
    events->key[source] = EVENT_KEY(clock, source);
}

static inline void events_find_first(events_t *events, unsigned group)
{
    const uint64_t *key = &events->key[EVENT_GROUP * group];
    events->first[group] = events_earlier(events_earlier(key[0], key[1]), events_earlier(key[2], key[3]));
}

/* Key of the next event of all. */
static inline uint64_t events_next(const events_t *events)
{
    return events_earlier(events_earlier(events->first[0], events->first[1]), events->first_rare);
}

static inline void events_handle(events_t *events, unsigned source)
{
    const event_handler_t *handler = &events->handler[source];
    handler->handle(handler->peripheral, source);
}

/* Cancel all events. */
static inline void events_reset(events_t *events)
{
    for (unsigned source = 0; source < EVENT_SOURCES; source++) {
        events_plan(events, source, CHIP_NEVER);
    }
}

#endif

/* event_log.h - what has happened, as lines of text with their tick: for the console of a client.
 *
 * The background compares each snapshot with the one before: the interrupts do nothing for it. Of what comes and goes
 * between two of its looks only the last is noted. Events are kept until their line is wanted; the oldest go first.
 */
#ifndef SERVO_APP_EVENT_LOG_H
#define SERVO_APP_EVENT_LOG_H

#include <stdbool.h>
#include <stdint.h>

#include "app/blocks.h"
#include "comm/freemaster.h"

#define EVENT_LOG_EVENTS 10
#define EVENT_LOG_LINE 56 /* bytes at most, with the end of the line */

typedef struct {
    uint32_t tick; /* PWM periods since reset */
    uint8_t kind; /* event_kind_t (log.c) */
    uint8_t axis; /* axis, or copy in the data flash */
    uint16_t value; /* new state, fault or offset */
} event_log_event_t;

typedef struct {
    fault_set_t faults;
    uint16_t state; /* state_t at the last look */
    uint16_t substate; /* substate_t, the same */
} event_log_axis_t;

typedef struct {
    event_log_event_t event[EVENT_LOG_EVENTS];
    uint16_t first; /* oldest event */
    uint16_t count; /* events kept */
    uint16_t lost; /* since the last line */
    uint32_t tick; /* of the snapshot looked at last */
    uint16_t points_refused; /* count of the snapshot looked at last */
    uint16_t late_loops; /* the same */
    uint16_t receiver_overruns; /* the same */
    event_log_axis_t axis[HAL_AXES];
} event_log_t;

/* The board has been reset, by its watchdog or not. */
void event_log_init(event_log_t *log, bool by_watchdog);

/* Note what is new in the snapshot, which an interrupt may be writing. */
void event_log_watch(event_log_t *log, const volatile snapshot_t *snapshot);

/* The board has not taken what was to be written at this offset of servo_t. */
void event_log_refused(event_log_t *log, uint16_t offset);

/* A copy in the data flash is not what it should be: stored_copy_t. */
void event_log_copy(event_log_t *log, uint16_t copy, uint16_t state);

/* Hand lines to the console of the client, as many as it has room for now. */
void event_log_print(event_log_t *log, freemaster_t *server);

#endif

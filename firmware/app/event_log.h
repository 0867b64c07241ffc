/* event_log.h - log of events as lines of text with their tick, for the console of a client.
 *
 * The background loop compares successive snapshots, without a part in the interrupts. Only the net change between
 * two comparisons is logged. Events are buffered until a client reads them; on overflow the oldest are discarded.
 */
#ifndef SERVO_APP_EVENT_LOG_H
#define SERVO_APP_EVENT_LOG_H

#include <stdbool.h>
#include <stdint.h>

#include "app/blocks.h"
#include "comm/freemaster.h"

#define EVENT_LOG_EVENTS 10
#define EVENT_LOG_LINE 56 /* largest length of a line with its end, bytes */

typedef struct {
    uint32_t tick; /* PWM periods since reset */
    uint8_t kind; /* event_kind_t (event_log.c) */
    uint8_t axis; /* axis, or copy in the data flash */
    uint16_t value; /* new state, fault or offset */
} event_log_event_t;

typedef struct {
    fault_set_t faults; /* captured faults at the last comparison */
    uint16_t state; /* state_t at the last comparison */
    uint16_t substate; /* substate_t at the last comparison */
} event_log_axis_t;

typedef struct {
    event_log_event_t event[EVENT_LOG_EVENTS];
    uint16_t first; /* index of the oldest event */
    uint16_t count; /* number of buffered events */
    uint16_t lost; /* number of events discarded since the last line */
    uint32_t tick; /* tick of the last compared snapshot */
    uint16_t points_refused; /* count of the last compared snapshot */
    uint16_t late_loops; /* count of the last compared snapshot */
    uint16_t receiver_overruns; /* count of the last compared snapshot */
    event_log_axis_t axis[HAL_AXES];
} event_log_t;

/* Initialise, and log the reset and its cause. */
void event_log_init(event_log_t *log, bool by_watchdog);

/* Log the changes of the snapshot, which an interrupt may be writing. */
void event_log_compare(event_log_t *log, const volatile snapshot_t *snapshot);

/* Log a refused write at this offset of servo_t. */
void event_log_refused(event_log_t *log, uint16_t offset);

/* Log a copy in the data flash that cannot be used; `state`: stored_copy_t. */
void event_log_copy(event_log_t *log, uint16_t copy, uint16_t state);

/* Log that the values before a measurement of an axis were restored, although its host did not end the session. */
void event_log_restored(event_log_t *log, uint16_t axis);

/* Write lines to the console of the client, as many as fit. */
void event_log_print(event_log_t *log, freemaster_t *server);

#endif

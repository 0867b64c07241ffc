#include "app/event_log.h"

#include <string.h>

#include "app/variables.h"
#include "comm/table_memory.h"
#include "config/contract_gen.h"

#define NAME_UNKNOWN "?"

typedef enum {
    EVENT_RESET,
    EVENT_WATCHDOG,
    EVENT_STATE,
    EVENT_FAULT,
    EVENT_CLEARED,
    EVENT_POINTS,
    EVENT_REFUSED,
    EVENT_COPY,
    EVENT_RESTORED,
    EVENT_LATE,
    EVENT_OVERRUN,
} event_kind_t;

/* ---- events ----------------------------------------------------------------------------------------------------- */

/* Repeated events must not push a fault out of the log: an event of a counting kind, or an equal one, replaces the
 * previous entry. */
static bool repeats(const event_log_event_t *event, event_kind_t kind, uint16_t value)
{
    const bool counts = kind == EVENT_LATE || kind == EVENT_OVERRUN;
    return event->kind == (uint8_t)kind &&
           (counts || ((kind == EVENT_POINTS || kind == EVENT_REFUSED) && event->value == value));
}

static void note(event_log_t *log, uint32_t tick, event_kind_t kind, uint16_t axis, uint16_t value)
{
    if (log->count != 0U) {
        event_log_event_t *newest = &log->event[(log->first + log->count - 1U) % EVENT_LOG_EVENTS];
        if (repeats(newest, kind, value)) {
            newest->tick = tick;
            newest->value = value;
            return;
        }
    }
    if (log->count == EVENT_LOG_EVENTS) {
        log->first = (uint16_t)((log->first + 1U) % EVENT_LOG_EVENTS);
        log->count--;
        log->lost = (uint16_t)(log->lost + (log->lost < UINT16_MAX ? 1U : 0U));
    }
    event_log_event_t *event = &log->event[(log->first + log->count) % EVENT_LOG_EVENTS];
    event->tick = tick;
    event->kind = (uint8_t)kind;
    event->axis = (uint8_t)axis;
    event->value = value;
    log->count++;
}

void event_log_init(event_log_t *log, bool by_watchdog)
{
    *log = (event_log_t){0};
    note(log, 0, by_watchdog ? EVENT_WATCHDOG : EVENT_RESET, 0, 0);
}

static void compare_axis(event_log_t *log, uint32_t tick, uint16_t index, const event_log_axis_t *now)
{
    event_log_axis_t *old = &log->axis[index];
    for (uint16_t bit = 0; bit < servo_fault_names.count; bit++) {
        if (((now->faults & ~old->faults) >> bit & 1U) != 0U) {
            note(log, tick, EVENT_FAULT, index, bit);
        }
    }
    if (now->faults == 0U && old->faults != 0U) {
        note(log, tick, EVENT_CLEARED, index, 0);
    }
    if (now->state != old->state || (now->state == (uint16_t)STATE_RUN && now->substate != old->substate)) {
        note(log, tick, EVENT_STATE, index, (uint16_t)(now->state << 8U | now->substate));
    }
    *old = *now;
}

static void compare_count(event_log_t *log, uint32_t tick, event_kind_t kind, uint16_t *old, uint16_t now,
                          uint16_t value)
{
    if (now != *old) {
        note(log, tick, kind, 0, value);
        *old = now;
    }
}

void event_log_compare(event_log_t *log, const volatile snapshot_t *snapshot)
{
    const uint32_t tick = snapshot->tick;
    if (tick == log->tick) {
        return;
    }
    event_log_axis_t axis[HAL_AXES];
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        axis[i].faults = snapshot->axis[i].faults;
        axis[i].state = snapshot->axis[i].state;
        axis[i].substate = snapshot->axis[i].substate;
    }
    const uint16_t points_refused = snapshot->points_refused;
    const uint16_t refusal = snapshot->point_refusal;
    const uint16_t late = snapshot->late_loops;
    const uint16_t overruns = snapshot->receiver_overruns;
    if (snapshot->tick != tick) {
        return; /* a newer snapshot was published meanwhile: compare at the next call */
    }
    log->tick = tick;
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        compare_axis(log, tick, i, &axis[i]);
    }
    compare_count(log, tick, EVENT_POINTS, &log->points_refused, points_refused, refusal);
    compare_count(log, tick, EVENT_LATE, &log->late_loops, late, late);
    compare_count(log, tick, EVENT_OVERRUN, &log->receiver_overruns, overruns, overruns);
}

void event_log_refused(event_log_t *log, uint16_t offset) { note(log, log->tick, EVENT_REFUSED, 0, offset); }

void event_log_copy(event_log_t *log, uint16_t copy, uint16_t state)
{
    note(log, log->tick, EVENT_COPY, 0, (uint16_t)(copy << 8U | state));
}

void event_log_restored(event_log_t *log, uint16_t axis) { note(log, log->tick, EVENT_RESTORED, axis, 0); }

/* ---- lines ------------------------------------------------------------------------------------------------------ */

typedef struct {
    uint8_t *text;
    uint16_t size;
} writer_t;

static void put(writer_t *writer, const char *text)
{
    for (; *text != '\0' && writer->size < EVENT_LOG_LINE - 1U; text++) {
        writer->text[writer->size++] = (uint8_t)*text;
    }
}

static void put_number(writer_t *writer, uint32_t number)
{
    char digits[11]; /* a 32-bit number */
    char *digit = &digits[sizeof digits - 1U];
    *digit = '\0';
    do {
        *--digit = (char)('0' + (char)(number % 10U));
        number /= 10U;
    } while (number != 0U);
    put(writer, digit);
}

/* Append a string of the table of variables. */
static void put_stored(writer_t *writer, uint16_t offset)
{
    const uint8_t *at = servo_variables.strings + offset;
    for (uint8_t c = table_byte(at); c != 0U && writer->size < EVENT_LOG_LINE - 1U; c = table_byte(++at)) {
        writer->text[writer->size++] = c;
    }
}

static void put_name(writer_t *writer, const name_list_t *names, uint16_t value)
{
    if (value < names->count) {
        put_stored(writer, names->offset[value]);
    } else {
        put(writer, NAME_UNKNOWN);
    }
}

static void put_variable(writer_t *writer, uint16_t offset)
{
    for (uint16_t i = 0; i < servo_variables.entries; i++) {
        tsa_entry_t entry;
        table_copy(&entry, &servo_variables.entry[i], sizeof entry);
        if (entry.kind == TSA_KIND_RW && offset + TSA_VARIABLES_BASE - entry.address < entry.size) {
            put_stored(writer, entry.name);
            return;
        }
    }
    put(writer, NAME_UNKNOWN);
}

static void put_event(writer_t *writer, const event_log_event_t *event)
{
    switch ((event_kind_t)event->kind) {
    case EVENT_RESET:
        put(writer, "reset");
        break;
    case EVENT_WATCHDOG:
        put(writer, "reset by the watchdog");
        break;
    case EVENT_STATE:
        put_name(writer, &servo_state_names, (uint16_t)(event->value >> 8U));
        if (event->value >> 8U == (uint16_t)STATE_RUN) {
            put(writer, "/");
            put_name(writer, &servo_substate_names, (uint16_t)(event->value & 0xFFU));
        }
        break;
    case EVENT_FAULT:
        put(writer, "fault ");
        put_name(writer, &servo_fault_names, event->value);
        break;
    case EVENT_CLEARED:
        put(writer, "faults cleared");
        break;
    case EVENT_POINTS:
        put(writer, "points refused: ");
        put_name(writer, &servo_refusal_names, event->value);
        break;
    case EVENT_REFUSED:
        put(writer, "refused ");
        put_variable(writer, event->value);
        break;
    case EVENT_COPY:
        put(writer, (event->value >> 8U == 0U) ? "stored copy A: " : "stored copy B: ");
        put_name(writer, &servo_copy_names, (uint16_t)(event->value & 0xFFU));
        break;
    case EVENT_RESTORED:
        put(writer, "measurement taken back");
        break;
    case EVENT_LATE:
        put(writer, "late loops: ");
        put_number(writer, event->value);
        break;
    case EVENT_OVERRUN:
        put(writer, "receiver overruns: ");
        put_number(writer, event->value);
        break;
    }
}

static bool is_of_an_axis(uint8_t kind)
{
    return kind == (uint8_t)EVENT_STATE || kind == (uint8_t)EVENT_FAULT || kind == (uint8_t)EVENT_CLEARED ||
           kind == (uint8_t)EVENT_RESTORED;
}

/* Format the oldest event as a line. */
static uint16_t compose(const event_log_t *log, uint8_t line[EVENT_LOG_LINE])
{
    writer_t writer = {line, 0};
    const event_log_event_t *event = &log->event[log->first];
    put_number(&writer, event->tick);
    put(&writer, " ");
    if (log->lost != 0U) {
        put(&writer, "lost before: ");
        put_number(&writer, log->lost);
    } else {
        if (is_of_an_axis(event->kind)) {
            put(&writer, "axis");
            put_number(&writer, event->axis + 1U);
            put(&writer, " ");
        }
        put_event(&writer, event);
    }
    line[writer.size++] = (uint8_t)'\n';
    return writer.size;
}

static void discard(event_log_t *log)
{
    if (log->lost != 0U) {
        log->lost = 0;
    } else {
        log->first = (uint16_t)((log->first + 1U) % EVENT_LOG_EVENTS);
        log->count--;
    }
}

void event_log_print(event_log_t *log, freemaster_t *server)
{
    while (log->count != 0U && freemaster_console_room(server) >= EVENT_LOG_LINE) {
        uint8_t line[EVENT_LOG_LINE];
        const uint16_t size = compose(log, line);
        freemaster_print(server, line, size);
        discard(log);
    }
}

/* servo_host.c - services for the host, all of them in the background; the interrupts are in servo.c. */
#include <stddef.h>

#include "app/login.h"
#include "app/measurement.h"
#include "app/points.h"
#include "app/ranges.h"
#include "app/servo.h"
#include "app/servo_storage.h"
#include "app/variables.h"
#include "config/board_gen.h"

#define RESULT_UNKNOWN 1u /* unknown command code */
#define RESULT_LEVEL 2u /* the client has not logged in to the level *command* */

static void lock(void *context, bool on)
{
    servo_t *servo = (servo_t *)context;
    servo->locked = on;
}

/* Locks through the server's function pointer: the compiler cannot inline the call, so it cannot move the protected
 * accesses out of the section. */
static void server_lock(servo_t *servo, bool on) { servo->freemaster.app.lock(servo, on); }

static bool is_boot_token(uint16_t offset)
{
    const uint16_t begin = (uint16_t)offsetof(servo_t, boot_token);
    return offset >= begin && offset < begin + sizeof((servo_t *)0)->boot_token;
}

static bool accepts_points(servo_t *servo, bool whole, const uint8_t *data, uint16_t size)
{
    const points_board_t board = {
        .axes = servo->axis,
        .snapshot = &servo->snapshot,
        .pending = servo->marks.points != 0U,
        .measuring = servo->measurement_status.state != MEASUREMENT_STATE_NONE,
    };
    const point_refusal_t refusal = whole ? points_check(&board, data, size) : POINT_REFUSAL_FORM;
    if (refusal != POINT_REFUSAL_NONE) {
        servo->point_refusal = (uint16_t)refusal;
        servo->points_refused++;
    }
    return refusal == POINT_REFUSAL_NONE;
}

static bool accepts(void *context, uint16_t offset, const uint8_t *data, const uint8_t *mask, uint16_t size)
{
    servo_t *servo = (servo_t *)context;
    const uint16_t points = (uint16_t)offsetof(servo_t, command.memory);
    if (offset >= points && (uint32_t)offset + size <= points + sizeof servo->command.memory) {
        return accepts_points(servo, offset == points && mask == NULL, data, size);
    }
    if (is_boot_token(offset) && servo->boot_token != 0U) {
        return false; /* written before */
    }
    const uint16_t config = (uint16_t)offsetof(servo_t, config);
    if (offset >= config && (uint32_t)offset + size <= config + sizeof servo->config) {
        const bool accepted = config_blocks_accept(&servo->config_blocks, &servo->config_status,
                                                   (uint16_t)(offset - config), mask == NULL, data, size);
        if (!accepted) {
            event_log_refused(&servo->event_log, offset);
        }
        return accepted;
    }
    const uint16_t storage = (uint16_t)offsetof(servo_t, storage_request);
    if (offset >= storage && (uint32_t)offset + size <= storage + sizeof servo->storage_request) {
        const bool accepted = servo_storage_accept(servo, offset, mask == NULL, data, size);
        if (!accepted) {
            event_log_refused(&servo->event_log, offset);
        }
        return accepted;
    }
    const uint16_t measurement = (uint16_t)offsetof(servo_t, measurement_request);
    if (offset >= measurement && (uint32_t)offset + size <= measurement + sizeof servo->measurement_request) {
        return measurement_accept(servo, (uint16_t)(offset - measurement), mask == NULL, data, size);
    }
    if (measurement_refuses(servo, offset, data, size)) {
        event_log_refused(&servo->event_log, offset);
        return false;
    }
    const ranges_memory_t memory = {
        .memory = (const uint8_t *)servo,
        .positions = (uint16_t)offsetof(servo_t, command.position),
        .features = (uint16_t)offsetof(servo_t, parameter.features),
        .feedbacks = (uint16_t)offsetof(servo_t, parameter.feedback),
        .snapshot = &servo->snapshot,
        .axes = servo->axis,
    };
    const bool accepted = ranges_accept(&memory, offset, data, mask, size);
    if (!accepted) {
        event_log_refused(&servo->event_log, offset);
    }
    return accepted;
}

static void written(void *context, uint16_t offset, uint16_t size)
{
    servo_t *servo = (servo_t *)context;
    const uint16_t begin = (uint16_t)offsetof(servo_t, command);
    if (offset >= begin && (uint32_t)offset + size <= begin + sizeof servo->command) {
        servo->host_commands++;
        latch_mark(&servo->marks, (uint16_t)(offset - begin), size);
    } else if (offset == offsetof(servo_t, measurement_request)) {
        servo->host_commands++; /* the session is supervised from its beginning */
    } else if (offset == offsetof(servo_t, config.window)) {
        config_blocks_show(&servo->config_blocks, &servo->config);
    } else if (offset >= offsetof(servo_t, parameter) &&
               offset < offsetof(servo_t, parameter) + sizeof servo->parameter) {
        servo->marks.parameters |= PARAMETERS_WRITTEN;
        storage_note_change(&servo->storage);
    }
}

static uint32_t nonce(void *context)
{
    const servo_t *servo = (const servo_t *)context;
    return login_nonce(servo->tick, servo->axis);
}

/* Access level to write a variable: *command* for what moves an axis, *tune* for what changes how it moves. */
static uint8_t level_to_write(void *context, uint16_t offset, uint16_t size)
{
    (void)context;
    (void)size; /* no variable spans the boundary of a block */
    const uint16_t begin = (uint16_t)offsetof(servo_t, command);
    const bool commands = offset >= begin && offset < begin + sizeof(command_block_t);
    const bool measures = offset == offsetof(servo_t, measurement_request);
    return (commands || measures || is_boot_token(offset)) ? ACCESS_COMMAND : ACCESS_TUNE;
}

static void write_to_all(servo_t *servo, uint16_t *field, uint16_t value)
{
    server_lock(servo, true);
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        field[i] = value;
    }
    const uint16_t offset = (uint16_t)((uint8_t *)field - (uint8_t *)&servo->command);
    latch_mark(&servo->marks, offset, (uint16_t)(HAL_AXES * sizeof field[0]));
    server_lock(servo, false);
}

static uint8_t put_u32(uint8_t *to, uint32_t value)
{
    for (uint16_t k = 0; k < 4U; k++) {
        to[k] = (uint8_t)(value >> (8U * k));
    }
    return 4;
}

static uint8_t app_command(void *context, uint8_t code, const uint8_t *args, uint16_t size, uint8_t *result,
                           uint16_t *result_size)
{
    servo_t *servo = (servo_t *)context;
    (void)args;
    (void)size;
    *result_size = 0;
    /* Any client may stop both axes. CLEAR_FAULTS and KEEP_ALIVE need the level *command*. */
    if ((code == COMMAND_CLEAR_FAULTS || code == COMMAND_KEEP_ALIVE) &&
        freemaster_level(&servo->freemaster) < ACCESS_COMMAND) {
        return RESULT_LEVEL;
    }
    switch (code) {
    case COMMAND_QUICK_STOP:
        servo->host_commands++;
        write_to_all(servo, servo->command.quick_stop, 1);
        server_lock(servo, true);
        measurement_end(servo, MEASUREMENT_END_STOPPED);
        server_lock(servo, false);
        return 0;
    case COMMAND_CLEAR_FAULTS:
        servo->host_commands++;
        write_to_all(servo, servo->command.clear_faults, 1);
        return 0;
    case COMMAND_KEEP_ALIVE:
        servo->host_commands++;
        return 0;
    case COMMAND_IDENTIFY:
        server_lock(servo, true);
        *result_size = put_u32(result, servo->catalogue_hash);
        *result_size = (uint16_t)(*result_size + put_u32(result + 4, servo->snapshot.tick));
        server_lock(servo, false);
        return 0;
    default:
        return RESULT_UNKNOWN;
    }
}

void servo_host_init(servo_t *servo, const servo_config_t *config)
{
    freemaster_app_t app = {
        .context = servo,
        .memory = (uint8_t *)servo,
        .memory_size = (uint32_t)offsetof(servo_t, hal),
        .live = (const uint8_t *)servo,
        .live_size = (uint32_t)sizeof *servo,
        .recorder = {{"PWM periods", BOARD_PWM_PERIOD_NS}, {"slow ticks", BOARD_PWM_PERIOD_NS * SERVO_SLOW_PERIODS}},
        .samples = servo->samples,
        .samples_size = (uint16_t)sizeof servo->samples,
        .tsa = &servo_variables,
        .name = "servo/" BOARD_NAME, /* the host knows the application and its board by it */
        .description = "dual-axis PMSM servo",
        .version = "servo FreeMASTER 4",
        .build = "reproducible", /* no date: equal sources give equal images */
        .lock = lock,
        .accepts = accepts,
        .written = written,
        .command = app_command,
        .console = "log",
        .nonce = nonce,
        .level_to_write = level_to_write,
    };
    login_passwords(&app.passwords, config);
    freemaster_init(&servo->freemaster, &app);
}

void servo_background(servo_t *servo)
{
    if (storage_busy(&servo->storage, servo->hal)) {
        freemaster_listen(&servo->freemaster, servo->hal); /* event log and requests need the tables */
        return;
    }
    event_log_compare(&servo->event_log, &servo->snapshot);
    event_log_print(&servo->event_log, &servo->freemaster);
    freemaster_poll(&servo->freemaster, servo->hal);
    servo_storage_step(servo);
    measurement_step(servo);
}

fm_status_t servo_read(servo_t *servo, uint32_t address, uint8_t *data, uint16_t size)
{
    return freemaster_read(&servo->freemaster, address, data, size);
}

fm_status_t servo_write(servo_t *servo, uint32_t address, const uint8_t *data, uint16_t size)
{
    const uint16_t commands = servo->host_commands;
    const fm_status_t status = freemaster_write(&servo->freemaster, address, data, NULL, size);
    servo->host_commands = commands;
    return status;
}

#include "app/measurement.h"

#include <stddef.h>

#include "drive/take_config.h"

static bool begins(servo_t *servo, uint16_t axis)
{
    measurement_status_t *status = &servo->measurement_status;
    if (status->state != MEASUREMENT_STATE_NONE || servo->storage_status.state != STORAGE_STATE_IDLE ||
        servo->marks.points != 0U || !config_blocks_keep(&servo->config_blocks, axis)) {
        measurement_end(servo, MEASUREMENT_END_REPLACED);
        return false;
    }
    servo->measurement = (measurement_t){
        .checksum = servo->config_status.checksum[axis],
        .speed = servo->command.speed[axis],
        .i_q = servo->command.i_q[axis],
        .mode = servo->command.mode[axis],
        .axis = axis,
        .enabled = servo->axis[axis].enable_requested,
    };
    servo->command.memory.measuring.parameter = servo->parameter;
    *status = (measurement_status_t){.state = MEASUREMENT_STATE_OPEN};
    return true;
}

bool measurement_accept(servo_t *servo, uint16_t offset, bool whole, const uint8_t *data, uint16_t size)
{
    if (!whole || offset != offsetof(measurement_request_t, axis) || size != sizeof(uint16_t) ||
        (data[0] & 0xFFU) > HAL_AXES || (data[1] & 0xFFU) != 0U) {
        return false;
    }
    const uint16_t number = (uint16_t)(data[0] & 0xFFU);
    if (number != 0U) {
        return begins(servo, (uint16_t)(number - 1U));
    }
    measurement_end(servo, MEASUREMENT_END_CLOSED);
    return true;
}

static void write_word(servo_t *servo, uint16_t *element, uint16_t value)
{
    *element = value;
    latch_mark(&servo->marks, (uint16_t)((uint8_t *)element - (uint8_t *)&servo->command), sizeof *element);
}

/* True if the axis has another block than at the beginning, or may get one in the next slow tick. */
static bool has_other_block(const servo_t *servo)
{
    const measurement_t *measurement = &servo->measurement;
    return servo->config_blocks.pending != 0U ||
           servo->config_status.checksum[measurement->axis] != measurement->checksum;
}

void measurement_end(servo_t *servo, measurement_end_t reason)
{
    measurement_t *measurement = &servo->measurement;
    if (servo->measurement_status.state != MEASUREMENT_STATE_OPEN) {
        return;
    }
    servo->measurement_status = (measurement_status_t){MEASUREMENT_STATE_RESTORING, (uint16_t)reason};
    config_blocks_reserve(&servo->config_blocks);
    measurement->stops = reason != MEASUREMENT_END_CLOSED || !measurement->enabled || has_other_block(servo);
    if (measurement->stops) {
        write_word(servo, &servo->command.enable[measurement->axis], 0);
    }
}

bool measurement_refuses(const servo_t *servo, uint16_t offset, const uint8_t *data, uint16_t size)
{
    if (servo->measurement_status.state != MEASUREMENT_STATE_RESTORING) {
        return false;
    }
    const uint16_t element = (uint16_t)((const uint8_t *)&servo->command.enable[servo->measurement.axis] -
                                        (const uint8_t *)servo); /* its low byte */
    return offset <= element && element < (uint32_t)offset + size && (data[element - offset] & 0xFFU) != 0U;
}

static void restore_values(servo_t *servo)
{
    const measurement_t *measurement = &servo->measurement;
    const uint16_t axis = measurement->axis;
    servo->parameter = servo->command.memory.measuring.parameter;
    servo->marks.parameters |= PARAMETERS_RENEWED;
    storage_note_change(&servo->storage);
    servo->command.speed[axis] = measurement->speed;
    servo->command.i_q[axis] = measurement->i_q;
    if (measurement->stops && servo->command.mode[axis] != measurement->mode) {
        write_word(servo, &servo->command.mode[axis], measurement->mode);
    }
    config_blocks_release(&servo->config_blocks);
    servo->measurement_status.state = MEASUREMENT_STATE_NONE;
    if (servo->measurement_status.ended != MEASUREMENT_END_CLOSED) {
        event_log_restored(&servo->event_log, axis);
    }
}

/* The supervision runs once per slow tick: a command that it has not seen yet ends the silence. */
static bool host_is_silent(const servo_t *servo)
{
    return servo->host_silent && servo->host_commands == servo->host_commands_seen;
}

static void step_locked(servo_t *servo)
{
    const measurement_t *measurement = &servo->measurement;
    const axis_t *axis = &servo->axis[measurement->axis];
    if (servo->measurement_status.state == MEASUREMENT_STATE_OPEN) {
        if (host_is_silent(servo)) {
            measurement_end(servo, MEASUREMENT_END_SILENT);
        }
    } else if (measurement->stops && (axis->sm.state == STATE_RUN || axis->enable_requested)) {
        return; /* the disable command is in progress */
    } else if (has_other_block(servo)) {
        if (axis_takes_any_config(axis)) {
            config_blocks_return(&servo->config_blocks, measurement->axis, measurement->checksum);
        }
    } else {
        restore_values(servo);
    }
}

void measurement_step(servo_t *servo)
{
    if (servo->measurement_status.state == MEASUREMENT_STATE_NONE) {
        return;
    }
    servo->freemaster.app.lock(servo, true);
    step_locked(servo);
    servo->freemaster.app.lock(servo, false);
}

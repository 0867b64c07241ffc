#include "app/servo_storage.h"

#include <stddef.h>

static storage_board_t storage_board(servo_t *servo)
{
    return (storage_board_t){
        .hal = servo->hal,
        .axes = servo->axis,
        .values = {(uint8_t *)servo, (uint16_t)offsetof(servo_t, parameter), &servo->config_blocks},
        .config_status = &servo->config_status,
        .event_log = &servo->event_log,
        .reserved = servo->measurement_status.state != MEASUREMENT_STATE_NONE,
        .request = (uint16_t)offsetof(servo_t, storage_request),
    };
}

bool servo_storage_accept(servo_t *servo, uint16_t offset, bool whole, const uint8_t *data, uint16_t size)
{
    const storage_board_t board = storage_board(servo);
    return storage_accept(&servo->storage, &servo->storage_status, &board, (uint16_t)(offset - board.request), whole,
                          data, size);
}

/* Values of the configuration in force. */
static void default_parameters(servo_t *servo, const servo_config_t *given)
{
    parameter_block_t *parameter = &servo->parameter;
    parameter->host_timeout = given->host_timeout;
    parameter->command_timeout = given->command_timeout;
    parameter->brake = given->bus_braking.fitted ? 1U : 0U;
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        const axis_config_t *config = config_blocks_in_force(&servo->config_blocks, i);
        parameter->speed_limit[i] = config->speed_limit;
        parameter->acceleration_limit[i] = config->acceleration_limit;
        parameter->i_q_limit[i] = config->i_q_limit;
        parameter->features[i] = config->features;
        parameter->feedback[i] = config->feedback;
        parameter->on_disable[i] = config->stop.disable;
        parameter->on_quick_stop[i] = config->stop.quick_stop;
        parameter->faults_enabled[i] = (fault_set_t)PARAM_FAULTS_ENABLED_MAX;
        parameter->position_min[i] = -config->position_limit;
        parameter->position_max[i] = config->position_limit;
        parameter->following_error[i] = config->following_error;
        parameter->over_speed[i] = config->over_speed;
    }
    for (uint16_t i = 0; i < HAL_ANALOG_OUTS; i++) {
        parameter->monitor[i] = MONITOR_NONE;
    }
}

void servo_restore(servo_t *servo, const servo_config_t *config)
{
    servo->bus_braking_config = config->bus_braking;
    config_blocks_init(&servo->config_blocks, &servo->config_status, config);
    default_parameters(servo, config);
    servo->storage_request = (storage_request_t){{0}};
    const storage_board_t board = storage_board(servo);
    storage_begin(&servo->storage, &servo->storage_status, &board);
    config_blocks_begin(&servo->config_blocks, &servo->config_status);
}

void servo_storage_step(servo_t *servo)
{
    const storage_board_t board = storage_board(servo);
    storage_step(&servo->storage, &servo->storage_status, &board);
}

#include "app/servo_storage.h"

#include <stddef.h>

static storage_board_t storage_board(servo_t *servo)
{
    return (storage_board_t){
        .hal = servo->hal,
        .axes = servo->axis,
        .values = {(uint8_t *)servo, (uint16_t)offsetof(servo_t, parameter), &servo->config_blocks},
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

void servo_restore(servo_t *servo, const servo_config_t *config)
{
    servo->bus_braking_config = config->bus_braking;
    config_blocks_init(&servo->config_blocks, &servo->config_status, config);
    parameters_default_board(&servo->parameter, config);
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        parameters_default_axis(&servo->parameter, i, config_blocks_in_force(&servo->config_blocks, i));
    }
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

/* servo_start.c - start of the application: not among the code that runs from RAM. */
#include "app/servo.h"

void servo_init(servo_t *servo, hal_t *hal, const servo_config_t *config)
{
    servo->catalogue_hash = CATALOGUE_HASH;
    servo->boot_token = 0;
    servo->hal = hal;
    servo->snapshot = (snapshot_t){0};
    servo->estimate = (estimate_block_t){0};
    servo->command = (command_block_t){0};
    servo->config = (config_request_t){0};
    const bool by_watchdog = hal_reset_by_watchdog(hal);
    event_log_init(&servo->event_log, by_watchdog);
    servo_restore(servo, config);
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        const axis_config_t *block = config_blocks_in_force(&servo->config_blocks, i);
        axis_init(&servo->axis[i], block, &servo->parameter, hal, i, &servo->record[i], &servo->tick);
        servo->nominal.torque_constant[i] = block->torque_constant;
        servo->nominal.acceleration_current[i] = block->acceleration_forward;
    }
    for (uint16_t i = 0; i < HAL_ANALOG_OUTS; i++) {
        servo->monitor[i] = 0;
    }
    parameters_of_board(&servo->settings, &servo->parameter);
    bus_braking_init(&servo->bus_braking);
    servo->tick = 0;
    servo->m2_awaited = false;
    servo->lateness = 0;
    servo->late_loops = 0;
    servo->hal_late_loops = hal_late_loops(hal);
    servo->monitoring = false;
    servo->applied_tick = 0;
    servo->applied_count = 0;
    servo->locked = false;
    latch_reset(&servo->marks);
    servo->marks.parameters |= PARAMETERS_RENEWED;
    servo->host_commands = 0;
    servo->host_commands_seen = 0;
    servo->host_idle_ticks = 0;
    servo->host_seen = false;
    servo->host_silent = false;
    servo->measurement_request = (measurement_request_t){0};
    servo->measurement_status = (measurement_status_t){0};
    servo->measurement = (measurement_t){0};

    if (by_watchdog) {
        for (uint16_t i = 0; i < HAL_AXES; i++) {
            axis_raise(&servo->axis[i], FOUND(FINDING_WATCHDOG_RESET));
        }
    }

    servo_host_init(servo, config);
}

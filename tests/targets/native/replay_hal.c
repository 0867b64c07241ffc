#include "replay_hal.h"

#include <string.h>

#include "config/servo_config.h"

/* ---- hal/hal.h -------------------------------------------------------------------------------------------------- */

static uint16_t take(hal_t *hal)
{
    if (hal->remaining == 0U) {
        hal->missing++;
        return 0;
    }
    hal->remaining--;
    return *hal->in++;
}

static adc_pair_t take_pair(hal_t *hal)
{
    adc_pair_t codes;
    codes.first = take(hal);
    codes.second = take(hal);
    return codes;
}

void hal_adc_select(hal_t *hal, uint16_t axis, phase_pair_t pair)
{
    out_head(&hal->out, OUT_SELECT, axis);
    out_word(&hal->out, (uint16_t)pair);
}

adc_pair_t hal_adc_currents(hal_t *hal, uint16_t axis)
{
    (void)axis;
    return take_pair(hal);
}

adc_pair_t hal_adc_offsets(hal_t *hal, uint16_t axis)
{
    (void)axis;
    return take_pair(hal);
}

uint16_t hal_adc_bus(hal_t *hal) { return take(hal); }

void hal_pwm_duty(hal_t *hal, uint16_t axis, int16_t duty_a, int16_t duty_b, int16_t duty_c)
{
    out_head(&hal->out, OUT_DUTY, axis);
    out_word(&hal->out, (uint16_t)duty_a);
    out_word(&hal->out, (uint16_t)duty_b);
    out_word(&hal->out, (uint16_t)duty_c);
}

void hal_pwm_enable(hal_t *hal, uint16_t axis, bool on)
{
    out_head(&hal->out, OUT_ENABLE, axis);
    out_word(&hal->out, on ? 1U : 0U);
}

bool hal_over_current_active(hal_t *hal, uint16_t axis)
{
    (void)axis;
    return take(hal) != 0U;
}

void hal_over_current_clear(hal_t *hal, uint16_t axis) { out_head(&hal->out, OUT_OVER_CURRENT_CLEAR, axis); }

uint16_t hal_encoder_count(hal_t *hal, uint16_t axis)
{
    (void)axis;
    return take(hal);
}

void hal_encoder_start(hal_t *hal, uint16_t axis, uint16_t period)
{
    out_head(&hal->out, OUT_ENCODER_START, axis);
    out_word(&hal->out, period);
}

void hal_encoder_preset(hal_t *hal, uint16_t axis, uint16_t count)
{
    out_head(&hal->out, OUT_PRESET, axis);
    out_word(&hal->out, count);
}

uint16_t hal_index_count(hal_t *hal, uint16_t axis)
{
    (void)axis;
    return take(hal);
}

void hal_capture_arm(hal_t *hal, uint16_t axis) { out_head(&hal->out, OUT_ARM, axis); }

bool hal_capture_take(hal_t *hal, uint16_t axis, edge_capture_t *capture)
{
    (void)axis;
    if (take(hal) == 0U) {
        return false;
    }
    capture->count = take(hal);
    capture->time = take(hal);
    return true;
}

uint32_t hal_edge_age(hal_t *hal, uint16_t axis)
{
    (void)axis;
    const uint32_t low = take(hal);
    return (uint32_t)take(hal) << 16 | low;
}

bool hal_serial_get(hal_t *hal, uint8_t *byte)
{
    if (take(hal) == 0U) {
        return false;
    }
    *byte = (uint8_t)take(hal);
    return true;
}

bool hal_serial_put(hal_t *hal, uint8_t byte)
{
    out_head(&hal->out, OUT_SERIAL, 0);
    out_word(&hal->out, byte);
    return take(hal) != 0U;
}

/* A command has its effect at once, as the firmware reads only after its end. */
bool hal_flash_present(hal_t *hal)
{
    (void)hal;
    return true;
}

/* NULL after the end of a set. */
static uint32_t *flash_word(hal_t *hal, uint16_t word)
{
    const uint16_t index = (uint16_t)(word % STORED_ROOM);
    return (index < STORED_WORDS) ? &hal->flash[word / STORED_ROOM][index] : NULL;
}

uint32_t hal_flash_read(hal_t *hal, uint16_t word)
{
    const uint32_t *at = flash_word(hal, word);
    return (at != NULL) ? *at : UINT32_MAX;
}

void hal_flash_erase(hal_t *hal, uint16_t sector)
{
    out_head(&hal->out, OUT_ERASE, 0);
    out_word(&hal->out, sector);
    for (uint16_t i = 0; i < HAL_FLASH_SECTOR_WORDS; i++) {
        uint32_t *at = flash_word(hal, (uint16_t)(sector * HAL_FLASH_SECTOR_WORDS + i));
        if (at != NULL) {
            *at = UINT32_MAX;
        }
    }
}

void hal_flash_program(hal_t *hal, uint16_t word, uint32_t value)
{
    out_head(&hal->out, OUT_PROGRAM, 0);
    out_word(&hal->out, word);
    out_word(&hal->out, (uint16_t)value);
    out_word(&hal->out, (uint16_t)(value >> 16));
    uint32_t *at = flash_word(hal, word);
    if (at != NULL) {
        *at &= value;
    }
}

hal_flash_t hal_flash_result(hal_t *hal) { return (hal_flash_t)take(hal); }

uint16_t hal_adc_temperature(hal_t *hal, uint16_t axis)
{
    (void)axis;
    return take(hal);
}

uint16_t hal_inputs(hal_t *hal, uint16_t axis)
{
    (void)axis;
    return take(hal);
}

uint16_t hal_late_loops(hal_t *hal) { return take(hal); }

uint16_t hal_receiver_overruns(hal_t *hal) { return take(hal); }

void hal_duties_done(hal_t *hal, uint16_t axis) { out_head(&hal->out, OUT_DONE, axis); }

bool hal_reset_by_watchdog(hal_t *hal) { return take(hal) != 0U; }

void hal_brake_resistor(hal_t *hal, bool on)
{
    out_head(&hal->out, OUT_BRAKE, 0);
    out_word(&hal->out, on ? 1U : 0U);
}

void hal_enable_input(hal_t *hal, uint16_t axis, bool used)
{
    out_head(&hal->out, OUT_ENABLE_INPUT, axis);
    out_word(&hal->out, used ? 1U : 0U);
}

void hal_holding_brake(hal_t *hal, uint16_t axis, bool release)
{
    out_head(&hal->out, OUT_HOLDING, axis);
    out_word(&hal->out, release ? 1U : 0U);
}

void hal_analog_out(hal_t *hal, uint16_t channel, uint16_t value)
{
    out_head(&hal->out, OUT_MONITOR, channel);
    out_word(&hal->out, value);
}

void hal_watchdog_service(hal_t *hal) { out_head(&hal->out, OUT_WATCHDOG, 0); }

/* ---- calls ------------------------------------------------------------------------------------------------------ */

void replay_power_on(hal_t *hal) { (void)memset(hal->flash, 0xFF, sizeof hal->flash); }

void replay_load(hal_t *hal, const trace_call_t *call)
{
    hal->in = call->in;
    hal->remaining = call->size;
    hal->missing = 0;
    hal->out.size = 0;
}

bool replay_call(servo_t *servo, hal_t *hal, const trace_call_t *call)
{
    const uint16_t axis = call->axis % HAL_AXES;
    switch (call->call) {
    case CALL_INIT:
        servo_init(servo, hal, &servo_config);
        return true;
    case CALL_M1:
        servo_m1_isr(servo);
        return true;
    case CALL_M2:
        servo_m2_isr(servo);
        return true;
    case CALL_BACKGROUND:
        servo_background(servo);
        return true;
    case CALL_EDGE:
        servo_edge_isr(servo, axis);
        return true;
    case CALL_OVER_CURRENT:
        servo_over_current_isr(servo, axis);
        return true;
    default:
        return false;
    }
}

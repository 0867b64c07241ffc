#include "fake_hal.h"

#include <string.h>

#define NO_AXIS UINT16_C(0xFFFF)

static const uint8_t first_phase[3] = {0, 1, 2};
static const uint8_t second_phase[3] = {1, 2, 0};

static void note(hal_t *hal, fake_call_t call, uint16_t axis, int32_t value)
{
    if (hal->logging && hal->events < FAKE_EVENTS) {
        const fake_event_t event = {(uint16_t)call, axis, value};
        hal->event[hal->events] = event;
        hal->events++;
    }
}

void fake_hal_init(hal_t *hal)
{
    memset(hal, 0, sizeof *hal);
    hal->bus_code = 2708; /* 24 V */
    memset(hal->flash, 0xFF, sizeof hal->flash);
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        fake_axis_t *axis = &hal->axis[i];
        for (uint16_t phase = 0; phase < 3; phase++) {
            axis->current_code[phase] = 2048;
            axis->offset_code[phase] = 2048;
        }
        axis->age = HAL_EDGE_AGE_OVERFLOW;
        axis->inputs = HAL_INPUT_ENABLE;
    }
}

static adc_pair_t convert(const fake_axis_t *axis, const uint16_t *code)
{
    const adc_pair_t pair = {code[first_phase[axis->pair]], code[second_phase[axis->pair]]};
    return pair;
}

void hal_adc_select(hal_t *hal, uint16_t axis, phase_pair_t pair)
{
    note(hal, FAKE_ADC_SELECT, axis, (int32_t)pair);
    hal->axis[axis].pair = pair;
}

adc_pair_t hal_adc_currents(hal_t *hal, uint16_t axis)
{
    note(hal, FAKE_ADC_CURRENTS, axis, 0);
    return convert(&hal->axis[axis], hal->axis[axis].current_code);
}

adc_pair_t hal_adc_offsets(hal_t *hal, uint16_t axis)
{
    note(hal, FAKE_ADC_OFFSETS, axis, 0);
    return convert(&hal->axis[axis], hal->axis[axis].offset_code);
}

uint16_t hal_adc_bus(hal_t *hal)
{
    note(hal, FAKE_ADC_BUS, NO_AXIS, 0);
    return hal->bus_code;
}

void hal_pwm_duty(hal_t *hal, uint16_t axis, int16_t duty_a, int16_t duty_b, int16_t duty_c)
{
    note(hal, FAKE_PWM_DUTY, axis, duty_a);
    hal->axis[axis].duty[0] = duty_a;
    hal->axis[axis].duty[1] = duty_b;
    hal->axis[axis].duty[2] = duty_c;
}

void hal_pwm_enable(hal_t *hal, uint16_t axis, bool on)
{
    fake_axis_t *a = &hal->axis[axis];
    note(hal, FAKE_PWM_ENABLE, axis, on ? 1 : 0);
    if (on && !a->outputs_on) {
        a->times_on++;
    }
    if (!on && a->outputs_on) {
        a->times_off++;
    }
    a->outputs_on = on;
}

bool hal_over_current_active(hal_t *hal, uint16_t axis)
{
    fake_axis_t *a = &hal->axis[axis];
    a->break_latched = a->break_latched || a->over_current;
    return a->break_latched;
}

void hal_over_current_clear(hal_t *hal, uint16_t axis)
{
    note(hal, FAKE_BREAK_CLEAR, axis, 0);
    hal->axis[axis].break_latched = false;
}

uint16_t hal_encoder_count(hal_t *hal, uint16_t axis)
{
    note(hal, FAKE_ENCODER_COUNT, axis, 0);
    return hal->axis[axis].count;
}

void hal_encoder_start(hal_t *hal, uint16_t axis, uint16_t period)
{
    note(hal, FAKE_ENCODER_START, axis, (int16_t)period);
    hal->axis[axis].count = 0;
}

void hal_encoder_preset(hal_t *hal, uint16_t axis, uint16_t count)
{
    note(hal, FAKE_ENCODER_PRESET, axis, (int16_t)count);
    hal->axis[axis].count = count;
}

uint16_t hal_index_count(hal_t *hal, uint16_t axis)
{
    note(hal, FAKE_INDEX_COUNT, axis, 0);
    return hal->axis[axis].index;
}

void hal_capture_arm(hal_t *hal, uint16_t axis)
{
    note(hal, FAKE_CAPTURE_ARM, axis, 0);
    hal->axis[axis].armed = true;
    hal->axis[axis].edge_waits = false;
}

bool hal_capture_take(hal_t *hal, uint16_t axis, edge_capture_t *capture)
{
    fake_axis_t *a = &hal->axis[axis];
    const bool taken = a->armed && a->edge_waits;
    note(hal, FAKE_CAPTURE_TAKE, axis, taken ? 1 : 0);
    if (taken) {
        *capture = a->edge;
        a->armed = false;
        a->edge_waits = false;
    }
    return taken;
}

uint32_t hal_edge_age(hal_t *hal, uint16_t axis)
{
    note(hal, FAKE_EDGE_AGE, axis, 0);
    return hal->axis[axis].age;
}

bool hal_flash_present(hal_t *hal) { return !hal->flash_absent; }

uint32_t hal_flash_read(hal_t *hal, uint16_t word)
{
    hal->flash_reads = (uint16_t)(hal->flash_reads + ((hal->flash_left > 0U) ? 1U : 0U));
    return hal->flash[word];
}

static void begin_flash(hal_t *hal, bool erases, uint16_t at, uint32_t value)
{
    hal->flash_left = (uint16_t)(hal->flash_polls + 1U);
    hal->flash_commands++;
    hal->flash_erases = erases;
    hal->flash_at = at;
    hal->flash_value = value;
}

void hal_flash_erase(hal_t *hal, uint16_t sector) { begin_flash(hal, true, sector, 0); }

void hal_flash_program(hal_t *hal, uint16_t word, uint32_t value) { begin_flash(hal, false, word, value); }

static void change_flash(hal_t *hal)
{
    const uint16_t words = hal->flash_erases ? HAL_FLASH_SECTOR_WORDS : 1U;
    uint32_t *word = &hal->flash[hal->flash_at * words];
    for (uint16_t i = 0; i < words; i++) {
        const uint32_t after = hal->flash_erases ? UINT32_MAX : word[i] & hal->flash_value;
        word[i] = (word[i] & hal->flash_stuck) | (after & ~hal->flash_stuck);
    }
}

hal_flash_t hal_flash_result(hal_t *hal)
{
    if (hal->flash_left > 1U) {
        hal->flash_left--;
        return HAL_FLASH_BUSY;
    }
    if (hal->flash_left == 1U) {
        hal->flash_left = 0;
        change_flash(hal);
    }
    return hal->flash_fails ? HAL_FLASH_FAILED : HAL_FLASH_DONE;
}

bool hal_serial_get(hal_t *hal, uint8_t *byte)
{
    if (hal->serial_in_taken >= hal->serial_in_size) {
        hal->serial_in_taken = 0;
        hal->serial_in_size = 0;
        return false;
    }
    *byte = hal->serial_in[hal->serial_in_taken];
    hal->serial_in_taken++;
    return true;
}

bool hal_serial_put(hal_t *hal, uint8_t byte)
{
    if (hal->serial_out_size >= FAKE_SERIAL) {
        return false;
    }
    hal->serial_out[hal->serial_out_size] = byte;
    hal->serial_out_size++;
    return true;
}

uint16_t hal_adc_temperature(hal_t *hal, uint16_t axis) { return hal->axis[axis].temperature_code; }

void hal_brake_resistor(hal_t *hal, bool on) { hal->brake_resistor = on; }

uint16_t hal_inputs(hal_t *hal, uint16_t axis) { return hal->axis[axis].inputs; }

void hal_enable_input(hal_t *hal, uint16_t axis, bool used) { hal->axis[axis].enable_used = used; }

void hal_holding_brake(hal_t *hal, uint16_t axis, bool release) { hal->axis[axis].holding_released = release; }

void hal_analog_out(hal_t *hal, uint16_t channel, uint16_t value) { hal->monitor[channel] = value; }

void hal_duties_done(hal_t *hal, uint16_t axis) { hal->duties_done[axis]++; }

uint16_t hal_late_loops(hal_t *hal) { return hal->late_loops; }

uint16_t hal_receiver_overruns(hal_t *hal) { return hal->receiver_overruns; }

bool hal_reset_by_watchdog(hal_t *hal) { return hal->reset_by_watchdog; }

void hal_watchdog_service(hal_t *hal)
{
    note(hal, FAKE_WATCHDOG, NO_AXIS, 0);
    hal->watchdog++;
}

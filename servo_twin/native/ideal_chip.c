#include "ideal_chip.h"

#include <string.h>

#include "board_clock.h"
#include "plant/inline.h"

#define WATCHDOG_NS UINT64_C(50000000)
#define DUTY_FULL (1.0 / 32767.0)
#define TWO_SHUNTS (BOARD_SHUNTS == 2UL)
#define DUTY_MAX_SAMPLED (1.0 - (double)BOARD_LOW_SIDE_NS / (double)BOARD_PWM_PERIOD_NS)
#define MIDDLE 2048

#if defined(BOARD_ODRIVE36)
#define COMMON_FAULT true /* one line of the gate drivers reports the over-current of either axis */
#define CONTACTS (1u << BOARD_PIN_HOME | 1u << BOARD_PIN_ENABLE) /* with a pin; the others read as open */
#else
#define COMMON_FAULT false
#define CONTACTS (1u << BOARD_PIN_HOME | 1u << BOARD_PIN_LIMIT_MIN | 1u << BOARD_PIN_LIMIT_MAX | 1u << BOARD_PIN_ENABLE)
#endif

typedef char check_time_stamps_have_the_clock_of_the_board
    [(BOARD_CLOCK_MHZ * 1000000UL == BOARD_STAMP_CLOCKS * BOARD_TIMER_CLOCK_HZ) ? 1 : -1];

static const int pair_phases[3][2] = {{0, 1}, {1, 2}, {2, 0}};

#define PAIR_AT_RESET (TWO_SHUNTS ? PHASE_PAIR_BC : PHASE_PAIR_AB)

static const chip_axis_t at_reset = {
    .written = true,
    .pair = PAIR_AT_RESET,
    .currents = {MIDDLE, MIDDLE},
    .offsets = {.phase = pair_phases[PAIR_AT_RESET]},
};

void chip_init(hal_t *chip, const board_config_t *config, servo_t *servo, const servo_config_t *servo_config)
{
    chip->servo = servo;
    chip->servo_config = servo_config;
    plant_init(&chip->plant, config);
    uart_init(&chip->uart, config->baud);
    flash_init(&chip->flash, config->flash, config->seed);
    for (int i = 0; i < HAL_AXES; i++) {
        chip->axis[i] = at_reset;
    }
    chip->bus_code = 0;
    chip->now_ns = 0;
    chip->grid_ns = 0;
    chip->sampled = 0;
    chip->scans = 0;
    chip->breaks = 0;
    chip->watchdog = 0;
    chip->watchdog_reset = false;
    chip->late = 0;
    chip->left_out = 0;
    chip->stalled_ns = 0;
    chip->served_ns = 0;
    for (int i = 0; i < HAL_ANALOG_OUTS; i++) {
        chip->monitor[i] = 0;
    }
}

/* ---- running time ------------------------------------------------------------------------------------------------- */

static void follow_enable(hal_t *chip, int i)
{
    const chip_axis_t *axis = &chip->axis[i];
    const bool released = !axis->enable_used || !axis->enable_open;
    chip->plant.axis[i].inverter.on = axis->enabled && !axis->tripped && released;
}

static double seconds(const hal_t *chip) { return 1e-9 * (double)chip->now_ns; }

static unsigned closed_contacts(const hal_t *chip, int i)
{
    return CONTACTS & plant_pins_closed(&chip->plant.axis[i].pins, chip->plant.axis[i].motor.theta);
}

/* An open enable circuit opens the switches without software. */
static void check_enable(hal_t *chip, int i)
{
    if ((closed_contacts(chip, i) & (1u << BOARD_PIN_ENABLE)) == 0u) {
        chip->axis[i].enable_open = true;
        follow_enable(chip, i);
    }
}

void chip_cut_wire(hal_t *chip, int axis, int pin, bool cut)
{
    plant_pins_cut(&chip->plant.axis[axis].pins, pin, cut, seconds(chip));
    check_enable(chip, axis);
}

static bool trip(hal_t *chip, int i, bool over)
{
    chip_axis_t *axis = &chip->axis[i];
    if (axis->tripped || !over) {
        return false;
    }
    axis->tripped = true;
    chip->breaks++;
    follow_enable(chip, i);
    return true;
}

static bool over_current(const hal_t *chip, int i)
{
    return plant_over_current(&chip->plant, i) || (COMMON_FAULT && plant_over_current(&chip->plant, 1 - i));
}

static bool beyond(int32_t codes)
{
    return codes > (int32_t)BOARD_OVER_CURRENT_CODES || codes < -(int32_t)BOARD_OVER_CURRENT_CODES;
}

/* The limit that a port without a comparator applies to the samples. */
static bool check_samples(hal_t *chip, int i)
{
    const int32_t first = (int32_t)chip->axis[i].currents.first - MIDDLE;
    const int32_t second = (int32_t)chip->axis[i].currents.second - MIDDLE;
    return BOARD_OVER_CURRENT_CODES > 0UL && trip(chip, i, beyond(first) || beyond(second) || beyond(first + second));
}

PLANT_INLINE void sample(hal_t *chip, int i, bool low_side_centre, plant_samples_t *samples)
{
    plant_sample(&chip->plant, i, pair_phases[chip->axis[i].pair], low_side_centre, samples);
}

PLANT_INLINE adc_pair_t codes_of(const hal_t *chip, int i, const plant_samples_t *samples)
{
    uint16_t code[2];
    plant_sample_codes(&chip->plant, i, samples, code);
    return (adc_pair_t){code[0], code[1]};
}

static bool awake(const hal_t *chip) { return chip->now_ns >= chip->stalled_ns; }

/* The watchdog was not served: reset of the chip; everything outside of it continues. */
static void watch_dog(hal_t *chip)
{
    if (chip->now_ns - chip->served_ns <= WATCHDOG_NS) {
        return;
    }
    for (int i = 0; i < HAL_AXES; i++) {
        const bool tripped = chip->axis[i].tripped;
        chip->axis[i] = at_reset;
        chip->axis[i].tripped = tripped;
        plant_pins_power(&chip->plant.axis[i].pins, false, seconds(chip));
        plant_encoder_restart(&chip->plant.axis[i].encoder);
        follow_enable(chip, i);
    }
    flash_break_off(&chip->flash, chip->now_ns);
    chip->watchdog_reset = true;
    chip->left_out = 0;
    chip->stalled_ns = 0;
    chip->served_ns = chip->now_ns;
    memset(chip->servo, 0, sizeof *chip->servo);
    servo_init(chip->servo, chip, chip->servo_config);
}

/* Currents of one axis, offsets of the other. */
PLANT_INLINE void scan(hal_t *chip, int sampled, int other)
{
    plant_samples_t currents;
    sample(chip, sampled, true, &currents);
    sample(chip, other, false, &chip->axis[other].offsets);
    chip->axis[sampled].currents = codes_of(chip, sampled, &currents);
}

/* Pairs only: the servo notices a single one. */
static void leave_out(hal_t *chip)
{
    chip->left_out++;
    if (chip->left_out % 2u == 0u) {
        chip->late = (uint16_t)(chip->late + 2u);
    }
}

/* Boundary of two half cycles: `sampled` is the axis whose low sides are at their centre. */
static void half_cycle(hal_t *chip, int sampled)
{
    if (sampled == 0) {
        scan(chip, 0, 1);
    } else {
        scan(chip, 1, 0);
    }
    chip->bus_code = plant_bus_code(&chip->plant);
    for (int i = 0; i < HAL_AXES; i++) {
        if (chip->axis[i].written) {
            chip->axis[i].written = false;
            averaged_inverter_load(&chip->plant.axis[i].inverter, chip->axis[i].duty, chip->plant.bus.u);
        }
    }
    watch_dog(chip);
    if (awake(chip)) {
        chip->left_out = 0;
        if (check_samples(chip, sampled)) {
            servo_over_current_isr(chip->servo, (uint16_t)sampled);
        }
        if (sampled == 0) {
            servo_m1_isr(chip->servo);
        } else {
            servo_m2_isr(chip->servo);
        }
        servo_background(chip->servo);
    } else {
        leave_out(chip);
    }
    chip->scans += (sampled != 0) ? 1u : 0u;
}

/* End of one step of the plant. */
static void grid(hal_t *chip)
{
    plant_t *plant = &chip->plant;
    if (chip->grid_ns > 0) { /* time zero is the beginning of the first step */
        plant_step(plant, chip->grid_ns - plant->step_ns);
        plant_update_holding_brakes(plant, seconds(chip));
        /* The comparators open the switches without software; a short has no current behind that. */
        const bool over[HAL_AXES] = {over_current(chip, 0), over_current(chip, 1)};
        for (int i = 0; i < HAL_AXES; i++) {
            if (trip(chip, i, over[i]) && awake(chip)) {
                servo_over_current_isr(chip->servo, (uint16_t)i);
            }
        }
    }
    const int sampled = chip->sampled;
    chip->sampled = 1 - sampled;
    chip->grid_ns += plant->step_ns;
    for (int i = 0; i < HAL_AXES; i++) {
        if (plant->axis[i].encoder.captured && awake(chip)) {
            servo_edge_isr(chip->servo, (uint16_t)i);
        }
    }
    half_cycle(chip, sampled);
}

bool chip_run(hal_t *chip, uint64_t until_ns, bool stop_after_scan)
{
    const uint32_t scans = chip->scans;
    for (;;) {
        if (plant_too_fast(&chip->plant)) {
            return false;
        }
        const uint64_t serial_ns = uart_next_ns(&chip->uart);
        const bool serial = serial_ns <= chip->grid_ns;
        const uint64_t next_ns = serial ? serial_ns : chip->grid_ns;
        if (next_ns > until_ns) {
            break;
        }
        chip->now_ns = next_ns;
        if (serial) {
            uart_run(&chip->uart, next_ns);
            if (awake(chip)) {
                servo_background(chip->servo);
            }
        } else {
            grid(chip);
            if (stop_after_scan && chip->scans != scans) {
                return true;
            }
        }
    }
    if (chip->now_ns < until_ns) {
        chip->now_ns = until_ns;
    }
    return false;
}

/* ---- hal/hal.h ---------------------------------------------------------------------------------------------------- */

void hal_adc_select(hal_t *hal, uint16_t axis, phase_pair_t pair) { hal->axis[axis].pair = pair; }

adc_pair_t hal_adc_currents(hal_t *hal, uint16_t axis) { return hal->axis[axis].currents; }

/* Read in one period of four only. */
adc_pair_t hal_adc_offsets(hal_t *hal, uint16_t axis) { return codes_of(hal, axis, &hal->axis[axis].offsets); }

uint16_t hal_adc_bus(hal_t *hal) { return hal->bus_code; }

void hal_pwm_duty(hal_t *hal, uint16_t axis, int16_t duty_a, int16_t duty_b, int16_t duty_c)
{
    const int16_t raw[3] = {duty_a, duty_b, duty_c};
    chip_axis_t *written = &hal->axis[axis];
    for (int k = 0; k < 3; k++) {
        const double duty = raw[k] * DUTY_FULL;
        written->duty[k] = (duty > 0.0) ? duty : 0.0;
        if (TWO_SHUNTS && k > 0 && duty > DUTY_MAX_SAMPLED) { /* phases b and c */
            written->duty[k] = DUTY_MAX_SAMPLED;
        }
    }
    written->written = true;
}

void hal_pwm_enable(hal_t *hal, uint16_t axis, bool on)
{
    hal->axis[axis].enabled = on;
    follow_enable(hal, axis);
}

bool hal_over_current_active(hal_t *hal, uint16_t axis) { return hal->axis[axis].tripped; }

void hal_over_current_clear(hal_t *hal, uint16_t axis)
{
    hal->axis[axis].tripped = false;
    if (!trip(hal, axis, over_current(hal, axis))) {
        follow_enable(hal, axis);
    }
}

uint16_t hal_encoder_count(hal_t *hal, uint16_t axis) { return hal->plant.axis[axis].encoder.count; }

void hal_encoder_start(hal_t *hal, uint16_t axis, uint16_t period)
{
    plant_encoder_start(&hal->plant.axis[axis].encoder, period);
}

void hal_encoder_preset(hal_t *hal, uint16_t axis, uint16_t count) { hal->plant.axis[axis].encoder.count = count; }

uint16_t hal_index_count(hal_t *hal, uint16_t axis) { return hal->plant.axis[axis].encoder.index; }

void hal_capture_arm(hal_t *hal, uint16_t axis) { plant_encoder_arm(&hal->plant.axis[axis].encoder); }

bool hal_capture_take(hal_t *hal, uint16_t axis, edge_capture_t *capture)
{
    return plant_encoder_take(&hal->plant.axis[axis].encoder, &capture->count, &capture->time);
}

uint32_t hal_edge_age(hal_t *hal, uint16_t axis)
{
    return plant_encoder_age(&hal->plant.axis[axis].encoder, hal->now_ns);
}

uint16_t hal_adc_temperature(hal_t *hal, uint16_t axis) { return plant_sink_code(&hal->plant, axis); }

void hal_brake_resistor(hal_t *hal, bool on) { supply_switch(&hal->plant.bus, on); }

uint16_t hal_inputs(hal_t *hal, uint16_t axis)
{
    const unsigned open = ~closed_contacts(hal, axis);
    const unsigned limits = open & (1u << BOARD_PIN_LIMIT_MIN | 1u << BOARD_PIN_LIMIT_MAX);
    const unsigned home = ~open & (1u << BOARD_PIN_HOME);
    return (uint16_t)(home | limits | (hal->axis[axis].enable_open ? 0u : HAL_INPUT_ENABLE));
}

void hal_enable_input(hal_t *hal, uint16_t axis, bool used)
{
    hal->axis[axis].enable_used = used;
    hal->axis[axis].enable_open = false;
    check_enable(hal, axis);
    follow_enable(hal, axis);
}

void hal_holding_brake(hal_t *hal, uint16_t axis, bool release)
{
    plant_pins_power(&hal->plant.axis[axis].pins, release, seconds(hal));
}

void hal_analog_out(hal_t *hal, uint16_t channel, uint16_t value) { hal->monitor[channel] = value; }

void hal_duties_done(hal_t *hal, uint16_t axis)
{
    (void)hal; /* loops take no time */
    (void)axis;
}

uint16_t hal_late_loops(hal_t *hal) { return hal->late; }

uint16_t hal_receiver_overruns(hal_t *hal) { return (uint16_t)hal->uart.overruns; }

bool hal_reset_by_watchdog(hal_t *hal) { return hal->watchdog_reset; }

/* The last sectors of the flash, as on the chip: the first ones are for tables. */
#define KEPT_WORD ((FLASH_DATA_SECTORS - HAL_FLASH_SECTORS) * FLASH_DATA_SECTOR_WORDS)

bool hal_flash_present(hal_t *hal)
{
    (void)hal;
    return true;
}

uint32_t hal_flash_read(hal_t *hal, uint16_t word) { return hal->flash.word[KEPT_WORD + word]; }

void hal_flash_erase(hal_t *hal, uint16_t sector)
{
    flash_erase(&hal->flash, FLASH_DATA_SECTORS - HAL_FLASH_SECTORS + sector, hal->now_ns);
}

void hal_flash_program(hal_t *hal, uint16_t word, uint32_t value)
{
    flash_program(&hal->flash, KEPT_WORD + word, value, hal->now_ns);
}

hal_flash_t hal_flash_result(hal_t *hal)
{
    if (flash_busy(&hal->flash, hal->now_ns)) {
        return HAL_FLASH_BUSY;
    }
    return hal->flash.failed ? HAL_FLASH_FAILED : HAL_FLASH_DONE;
}

bool hal_serial_get(hal_t *hal, uint8_t *byte) { return uart_get(&hal->uart, byte); }

bool hal_serial_put(hal_t *hal, uint8_t byte) { return uart_put(&hal->uart, byte, hal->now_ns); }

void hal_watchdog_service(hal_t *hal)
{
    hal->watchdog++;
    hal->served_ns = hal->now_ns;
}

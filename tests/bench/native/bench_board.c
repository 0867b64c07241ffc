#include "bench_board.h"

#include "control/transforms.h"

#define COUNTS INT32_C(4000)
#define POLE_PAIRS 2
#define MID_CODE 2048
#define CURRENT_BITS 27
#define BUS_CODE 2708 /* 24 V */

/* Per period, in full scales (24.2 V, 8.25 A, 5000 rpm) with 15 fraction bits. */
#define VOLTAGE_OF_BUS INT32_C(49152) /* 36.3 V over 24.2 V */
#define CURRENT_OF_VOLTAGE INT32_C(13130) /* Ts U / (L I), 0.457 mH */
#define CURRENT_DECAY INT32_C(2465) /* R Ts / L, 0.55 ohm */
#define EMF_OF_SPEED INT32_C(21836) /* psi omega / U, 15.4 mV s */
#define SPEED_OF_CURRENT INT32_C(186) /* Kt I Ts / (J omega), 46.2 mN m/A, 8e-6 kg m^2 */
#define FRICTION INT32_C(62000) /* 2 mN m, 31 fraction bits */
/* Counts per period at full-scale speed, 16 fraction bits. */
#define COUNTS_OF_SPEED INT32_C(1365333)
/* Timer ticks of 781.25 kHz in 64 periods of 16 kHz. */
#define TICKS_OF_64 UINT32_C(3125)

static int32_t scaled(int32_t x, int32_t factor_q15) { return (int32_t)asr64((int64_t)x * factor_q15, 15); }

void bench_board_init(hal_t *hal)
{
    *hal = (hal_t){0};
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        hal->axis[i].offsets = (adc_pair_t){MID_CODE, MID_CODE};
        hal->axis[i].currents = (adc_pair_t){MID_CODE, MID_CODE};
    }
    hal->bus = BUS_CODE;
}

/* ---- motor ------------------------------------------------------------------------------------------------------- */

static sin_cos_t rotor(const bench_motor_t *motor)
{
    const int32_t angle = (int32_t)asr64((int64_t)motor->angle * POLE_PAIRS * 65536 / COUNTS, 16);
    return sin_cos((frac16_t)(uint16_t)((uint32_t)angle & 0xFFFFU));
}

/* The duties of the last period drive the currents; i_q accelerates the shaft. */
static void run_motor(bench_motor_t *motor, const bench_registers_t *registers, uint16_t bus)
{
    const sin_cos_t at = rotor(motor);
    ab_t u = {0, 0};
    if (registers->enabled) {
        const int32_t volts = scaled((int32_t)bus * 8, VOLTAGE_OF_BUS);
        const ab_t duty = clarke((abc_t){registers->duty[0], registers->duty[1], registers->duty[2]});
        u = (ab_t){sat16(scaled(volts, duty.alpha)), sat16(scaled(volts, duty.beta))};
    }
    const int32_t emf = scaled(asr32(motor->speed, 16), EMF_OF_SPEED);
    const int32_t left_alpha = u.alpha + scaled(emf, at.sin);
    const int32_t left_beta = u.beta - scaled(emf, at.cos);
    motor->i_alpha += asr32(left_alpha * CURRENT_OF_VOLTAGE, 30 - CURRENT_BITS) - scaled(motor->i_alpha, CURRENT_DECAY);
    motor->i_beta += asr32(left_beta * CURRENT_OF_VOLTAGE, 30 - CURRENT_BITS) - scaled(motor->i_beta, CURRENT_DECAY);

    const int32_t i_q = scaled(motor->i_beta, at.cos) - scaled(motor->i_alpha, at.sin);
    const frac32_t free = f32_add(motor->speed, scaled(i_q, SPEED_OF_CURRENT) * (INT32_C(1) << (31 - CURRENT_BITS)));
    motor->speed = (free > FRICTION) ? free - FRICTION : (free < -FRICTION) ? free + FRICTION : 0;
}

/* ---- encoder ----------------------------------------------------------------------------------------------------- */

static uint32_t timer(uint32_t period) { return period / 64U * TICKS_OF_64 + period % 64U * TICKS_OF_64 / 64U; }

/* The first B edge between two positions [counts], if there is one. B changes between an odd count and the even count
 * above it. */
static bool edge_between(int32_t from, int32_t to, int32_t *edge)
{
    const int32_t low = (from < to) ? from : to;
    const int32_t high = (from < to) ? to : from;
    *edge = (from < to) ? (asr32(low, 1) + 1) * 2 : asr32(high, 1) * 2;
    return low < *edge && *edge <= high;
}

static void turn_encoder(bench_motor_t *motor, bench_registers_t *registers, uint32_t period)
{
    const int32_t step = (int32_t)asr64((int64_t)motor->speed * COUNTS_OF_SPEED, 31);
    const int32_t from = asr32(motor->angle, 16);
    int32_t angle = motor->angle + step;
    int32_t to = asr32(angle, 16);
    int32_t edge;
    if (edge_between(from, to, &edge)) {
        const int32_t moved = (to > from) ? to - from : from - to;
        const int32_t part = (to > from) ? edge - from : from - edge;
        const uint32_t begin = timer(period);
        motor->edge_time = begin + (timer(period + 1U) - begin) * (uint32_t)part / (uint32_t)moved;
        if (registers->armed) {
            registers->edge = (edge_capture_t){(uint16_t)(edge % COUNTS), (uint16_t)motor->edge_time};
            registers->captured = true;
            registers->armed = false;
        }
    }
    if (to >= COUNTS || to <= -COUNTS) {
        const int32_t turn = (to > 0) ? COUNTS : -COUNTS;
        angle -= turn * 65536;
        to -= turn;
        registers->index++;
    }
    motor->angle = angle;
    registers->count = (uint16_t)to;
    const uint32_t age = timer(period + 1U) - motor->edge_time;
    registers->edge_age = (age < HAL_EDGE_AGE_OVERFLOW) ? age : HAL_EDGE_AGE_OVERFLOW;
}

/* ---- converters -------------------------------------------------------------------------------------------------- */

static uint16_t code_of(int32_t current)
{
    const int32_t code = MID_CODE + asr32(current, CURRENT_BITS - 11);
    return (uint16_t)((code < 0) ? 0 : (code > 4095) ? 4095 : code);
}

static void convert(const bench_motor_t *motor, bench_registers_t *registers)
{
    const int32_t half_alpha = motor->i_alpha / 2;
    const int32_t beta = scaled(motor->i_beta, 28378); /* sqrt(3) / 2 */
    const uint16_t a = code_of(motor->i_alpha);
    const uint16_t b = code_of(beta - half_alpha);
    const uint16_t c = code_of(-beta - half_alpha);
    registers->currents = (registers->pair == PHASE_PAIR_AB)   ? (adc_pair_t){a, b}
                          : (registers->pair == PHASE_PAIR_BC) ? (adc_pair_t){b, c}
                                                               : (adc_pair_t){c, a};
}

void bench_board_step(hal_t *hal)
{
    hal->bus = (uint16_t)(BUS_CODE + (hal->period & 15U)); /* ripple of 0.13 V */
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        run_motor(&hal->motor[i], &hal->axis[i], hal->bus);
        turn_encoder(&hal->motor[i], &hal->axis[i], hal->period);
        convert(&hal->motor[i], &hal->axis[i]);
    }
    hal->period++;
}

/* ---- hal/hal.h --------------------------------------------------------------------------------------------------- */

void hal_adc_select(hal_t *hal, uint16_t axis, phase_pair_t pair) { hal->axis[axis].pair = pair; }

adc_pair_t hal_adc_currents(hal_t *hal, uint16_t axis) { return hal->axis[axis].currents; }

adc_pair_t hal_adc_offsets(hal_t *hal, uint16_t axis) { return hal->axis[axis].offsets; }

uint16_t hal_adc_bus(hal_t *hal) { return hal->bus; }

void hal_pwm_duty(hal_t *hal, uint16_t axis, int16_t duty_a, int16_t duty_b, int16_t duty_c)
{
    bench_registers_t *a = &hal->axis[axis];
    a->duty[0] = duty_a;
    a->duty[1] = duty_b;
    a->duty[2] = duty_c;
}

void hal_pwm_enable(hal_t *hal, uint16_t axis, bool on) { hal->axis[axis].enabled = on; }

bool hal_over_current_active(hal_t *hal, uint16_t axis) { return hal->axis[axis].tripped; }

void hal_over_current_clear(hal_t *hal, uint16_t axis) { hal->axis[axis].tripped = false; }

uint16_t hal_encoder_count(hal_t *hal, uint16_t axis) { return hal->axis[axis].count; }

void hal_encoder_start(hal_t *hal, uint16_t axis, uint16_t period)
{
    (void)period;
    hal->axis[axis].count = 0;
}

void hal_encoder_preset(hal_t *hal, uint16_t axis, uint16_t count) { hal->axis[axis].count = count; }

uint16_t hal_index_count(hal_t *hal, uint16_t axis) { return hal->axis[axis].index; }

void hal_capture_arm(hal_t *hal, uint16_t axis) { hal->axis[axis].armed = true; }

bool hal_capture_take(hal_t *hal, uint16_t axis, edge_capture_t *capture)
{
    bench_registers_t *a = &hal->axis[axis];
    if (!a->captured) {
        return false;
    }
    *capture = a->edge;
    a->captured = false;
    return true;
}

uint32_t hal_edge_age(hal_t *hal, uint16_t axis) { return hal->axis[axis].edge_age; }

bool hal_serial_get(hal_t *hal, uint8_t *byte)
{
    *byte = (uint8_t)(hal->serial & 0xFFU);
    const bool there = hal->serial > 0xFFU;
    hal->serial = 0;
    return there;
}

bool hal_flash_present(hal_t *hal)
{
    (void)hal;
    return false;
}

uint32_t hal_flash_read(hal_t *hal, uint16_t word)
{
    (void)hal;
    (void)word;
    return UINT32_MAX;
}

void hal_flash_erase(hal_t *hal, uint16_t sector)
{
    (void)hal;
    (void)sector;
}

void hal_flash_program(hal_t *hal, uint16_t word, uint32_t value)
{
    (void)hal;
    (void)word;
    (void)value;
}

hal_flash_t hal_flash_result(hal_t *hal)
{
    (void)hal;
    return HAL_FLASH_DONE;
}

bool hal_serial_put(hal_t *hal, uint8_t byte)
{
    hal->sent = byte;
    return true;
}

uint16_t hal_adc_temperature(hal_t *hal, uint16_t axis)
{
    (void)hal;
    return (uint16_t)(700U + axis);
}

void hal_brake_resistor(hal_t *hal, bool on) { hal->brake_resistor = on; }

uint16_t hal_inputs(hal_t *hal, uint16_t axis)
{
    (void)hal;
    (void)axis;
    return HAL_INPUT_ENABLE;
}

void hal_enable_input(hal_t *hal, uint16_t axis, bool used)
{
    (void)hal;
    (void)axis;
    (void)used;
}

void hal_holding_brake(hal_t *hal, uint16_t axis, bool release)
{
    (void)hal;
    (void)axis;
    (void)release;
}

void hal_analog_out(hal_t *hal, uint16_t channel, uint16_t value) { hal->monitor[channel] = value; }

void hal_duties_done(hal_t *hal, uint16_t axis)
{
    (void)hal;
    (void)axis;
}

uint16_t hal_receiver_overruns(hal_t *hal)
{
    (void)hal;
    return 0;
}

uint16_t hal_late_loops(hal_t *hal)
{
    (void)hal;
    return 0;
}

bool hal_reset_by_watchdog(hal_t *hal)
{
    (void)hal;
    return false;
}

void hal_watchdog_service(hal_t *hal) { hal->watchdog++; }

/* cost.c - instructions of the interrupts while both axes move in every mode.
 *
 * The image selects the run: features of the configuration (0), all features (1), or no encoders (2); the phases (a bit
 * each); and the maximum length of a phase in units of 16 PWM periods. Prints "PHASE KIND NUMBER MIN MAX SUM" in
 * hexadecimal for each count, and at the end "axis NUMBER SUBSTATE FAULTS SPEED POSITION".
 */
#include "cost.h"

#include <stddef.h>

#include "app/servo.h"
#include "bench_board.h"
#include "config/servo_config.h"
#include "drive/motion.h"
#include "drive/sensorless_estimate.h"
#include "machine.h"
#include "text.h"

#define RAD_PER_S(x) ((frac32_t)(INT32_C(4101391) * (x))) /* of 523.6 rad/s */
#define AMPERE(x) ((frac16_t)(INT32_C(3972) * (x)))       /* of 8.25 A */

#define ALL_FEATURES 1U
#define WITHOUT_ENCODERS 2U

#define SILENCE 64U /* PWM periods before the count of a phase begins: the last command is processed */

typedef struct {
    uint16_t mode;
    uint16_t periods;
    int32_t position; /* relative to the present position, counts */
    frac32_t speed;
    frac16_t i_q;
} phase_t;

/* Phases of normal operation, and last the voltage limit. Axis 2 rotates in the opposite direction. */
static const phase_t phases[] = {
    {CONTROL_MODE_POSITION, 800, 0, 0, 0},
    {CONTROL_MODE_POSITION, 4800, 20000, 0, 0},
    {CONTROL_MODE_SPEED, 1600, 0, RAD_PER_S(150), 0},
    {CONTROL_MODE_SPEED, 3200, 0, RAD_PER_S(1) / 2, 0},
    {CONTROL_MODE_TORQUE, 800, 0, 0, AMPERE(1)},
    {CONTROL_MODE_SPEED, 3200, 0, RAD_PER_S(480), 0},
};
#define PHASES (sizeof phases / sizeof phases[0])

typedef struct {
    uint32_t number;
    uint32_t least;
    uint32_t most;
    uint32_t sum;
} cost_t;

static servo_t servo;
static hal_t hal;
static cost_t costs[COST_KINDS];

void cost_add(cost_kind_t kind, uint32_t instructions)
{
    cost_t *cost = &costs[kind];
    cost->least = (cost->number == 0U || instructions < cost->least) ? instructions : cost->least;
    cost->most = (instructions > cost->most) ? instructions : cost->most;
    cost->sum += instructions;
    cost->number++;
}

static void forget(void)
{
    for (uint16_t kind = 0; kind < COST_KINDS; kind++) {
        costs[kind] = (cost_t){0};
    }
}

static void report(uint16_t phase)
{
    for (uint16_t kind = 0; kind < COST_KINDS; kind++) {
        const cost_t *cost = &costs[kind];
        text_word("", phase, " ");
        text_word("", kind, " ");
        text_long("", cost->number, " ");
        text_long("", cost->least, " ");
        text_long("", cost->most, " ");
        text_long("", cost->sum, "\n");
    }
}

/* Including call and return. */
static uint32_t measured(void (*isr)(servo_t *))
{
    const uint32_t begin = machine_clock();
    isr(&servo);
    return machine_instructions(begin, machine_clock());
}

/* State after a successful rotor search; the state machine continues from here. */
static void put_into_spin(axis_t *axis)
{
    axis->sm.state = STATE_RUN;
    axis->substate = SUBSTATE_SPIN;
    axis->enable_requested = true;
    axis->encoder.found = true;
    motion_start(axis);
    hal_pwm_enable(&hal, axis->index, true);
}

/* State after a successful start-up: the shaft rotates and the observer is locked. */
static void put_into_observed_spin(axis_t *axis, frac32_t speed)
{
    const pll_config_t *pll = &axis->config->pll;
    bench_motor_t *motor = &hal.motor[axis->index];
    motor->speed = speed;
    const uint32_t turns =
        (uint32_t)((int64_t)motor->angle * axis->config->encoder.pole_pairs * 65536 / POSITION_PER_TURN);
    sensorless_estimate_start(axis, turns, pll_step_of(pll, speed));
    axis->estimate.locked = true;
    axis->feedback.speed = speed;
    axis->fast = LOOP_OBSERVED;
    axis->sm.state = STATE_RUN;
    axis->substate = SUBSTATE_SPIN;
    axis->enable_requested = true;
    motion_start_turning(axis, 0);
    hal_pwm_enable(&hal, axis->index, true);
}

/* All harmonics of the torque ripple. */
static void set_ripple(uint16_t axis)
{
    torque_ripple_config_t *ripple = &config_blocks_writable(&servo.config_blocks, axis)->torque_ripple;
    for (uint16_t k = 0; k < RIPPLE_HARMONICS; k++) {
        ripple->order[k] = (uint16_t)(12U * (k + 1U));
        ripple->amplitude[k] = 100;
        ripple->phase[k] = (uint16_t)(7000U * k);
    }
}

static void command(const phase_t *phase)
{
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        const int32_t way = (i == 0U) ? 1 : -1;
        servo.command.mode[i] = phase->mode;
        servo.command.position[i] = servo.axis[i].feedback.position + way * phase->position;
        servo.command.speed[i] = way * phase->speed;
        servo.command.i_q[i] = (frac16_t)(way * phase->i_q);
    }
    latch_mark(&servo.marks, 0, (uint16_t)offsetof(command_block_t, enable));
}

static void run_period(void)
{
    bench_board_step(&hal);
    const uint32_t m1 = measured(servo_m1_isr);
    const uint32_t m2 = measured(servo_m2_isr);
    servo_background(&servo);
    const uint16_t period = (uint16_t)(servo.tick % SERVO_SLOW_PERIODS);
    cost_add(COST_INTERRUPT(period, 0U), m1);
    cost_add(COST_INTERRUPT(period, 1U), m2);
}

int main(void)
{
    machine_start();
    bench_board_init(&hal);
    servo_init(&servo, &hal, &servo_config);
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        servo.parameter.faults_enabled[i] = 0; /* these motors are too simple for every monitor */
        servo.parameter.feedback[i] =
            (machine_image(0) == WITHOUT_ENCODERS) ? FEEDBACK_KIND_OBSERVER : FEEDBACK_KIND_ENCODER;
        if (machine_image(0) == ALL_FEATURES) {
            servo.parameter.features[i] = (uint32_t)PARAM_FEATURES_MAX;
            set_ripple(i);
            servo.axis[i].home.state = HOME_STATE_KNOWN; /* otherwise set-points would be refused */
        }
        servo.parameter.speed_limit[i] = RAD_PER_S(419); /* above the voltage limit */
        servo.parameter.over_speed[i] = RAD_PER_S(520);
    }
    const uint16_t wanted = machine_image(1);
    const uint16_t most = (uint16_t)(machine_image(2) * 16U);
    for (uint16_t k = 0; k < SILENCE; k++) {
        run_period();
    }
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        if (machine_image(0) == WITHOUT_ENCODERS) {
            put_into_observed_spin(&servo.axis[i], (i == 0U) ? RAD_PER_S(150) : -RAD_PER_S(150));
        } else {
            put_into_spin(&servo.axis[i]);
        }
    }
    for (uint16_t phase = 0; phase < PHASES; phase++) {
        if ((wanted & (1U << phase)) == 0U) {
            continue;
        }
        command(&phases[phase]);
        for (uint16_t k = 0; k < phases[phase].periods && k < most; k++) {
            if (k == SILENCE) {
                forget();
            }
            run_period();
        }
        report(phase);
    }
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        text_word("axis ", i, " ");
        text_word("", (uint16_t)servo.axis[i].substate, " ");
        text_long("", servo.axis[i].latch.captured, " ");
        text_long("", (uint32_t)servo.axis[i].feedback.speed, " ");
        text_long("", (uint32_t)servo.axis[i].feedback.position, "\n");
    }
    machine_stop(0);
}

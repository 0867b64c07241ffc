#include "plant/plant.h"

static inline plant_lane_t lane_of(plant_drive_t *axis)
{
    return (plant_lane_t){&axis->inverter, &axis->motor, axis->voltage_sum};
}

void plant_init(plant_t *plant, const board_config_t *config)
{
    *plant = (plant_t){.bus_config = config->bus};
    plant->step_ns = (uint64_t)(1e9 / config->pwm_frequency / (2.0 * PLANT_STEPS_PER_HALF) + 0.5);
    const double step = (double)plant->step_ns * 1e-9;
    plant->steps_per_second = 1.0 / step;
    plant_bus_init(&plant->bus, &config->bus, step);
    plant_random_init(&plant->bus_noise, config->seed, 0);
    for (int i = 0; i < BOARD_AXES; i++) {
        plant_drive_t *axis = &plant->axis[i];
        axis->config = config->axis[i];
        plant_inverter_init(&axis->inverter, &config->axis[i], config->pwm_frequency, step);
        plant_motor_init(&axis->motor, &config->axis[i]);
        plant_encoder_init(&axis->encoder, &config->axis[i]);
        plant_random_init(&axis->noise, config->seed, (uint64_t)i + 1u);
        axis->codes_per_ampere = 2048.0 / config->axis[i].i_full_scale;
    }
    plant->codes_per_volt = 4096.0 / config->bus.u_full_scale;
    const plant_lane_t lane[2] = {lane_of(&plant->axis[0]), lane_of(&plant->axis[1])};
    plant_pair_init(&plant->pair, lane, step);
}

/* Returns the charge drawn from the bus [A s]. */
static double axis_step(plant_drive_t *axis, double u_dc, uint64_t now_ns, uint64_t step_ns)
{
    plant_motor_t *motor = &axis->motor;
    const double step = (double)step_ns;
    double done = 0.0; /* [ns] */
    double charge = 0.0;
    while (done < step) {
        plant_movement_t movement = {.theta_0 = motor->theta, .omega_0 = motor->omega, .start_ns = done};
        const double rest = step - done;
        const double used = 1e9 * plant_inverter_step(&axis->inverter, motor, u_dc, 1e-9 * rest, &charge);
        movement.duration_ns = used;
        movement.theta_1 = motor->theta;
        movement.omega_1 = motor->omega;
        if (plant_encoder_leaves(&axis->encoder, motor->theta)) {
            plant_encoder_move(&axis->encoder, &movement, now_ns);
        }
        /* less than a nanosecond left is only the rounding of the units */
        done = (rest - used < 0.5) ? step : done + used;
    }
    for (int k = 0; k < 3; k++) {
        axis->voltage_sum[k] += axis->inverter.leg[k] - axis->inverter.r_on * motor->phase[k] - 0.5 * u_dc;
    }
    return charge;
}

void plant_step(plant_t *plant, uint64_t now_ns)
{
    plant_drive_t *drive = plant->axis;
    const plant_lane_t lane[2] = {lane_of(&drive[0]), lane_of(&drive[1])};
    const double theta[2] = {drive[0].motor.theta, drive[1].motor.theta};
    const double omega[2] = {drive[0].motor.omega, drive[1].motor.omega};
    double charge;
    const unsigned taken = plant_pair_step(&plant->pair, lane, plant->bus.u_dc, &charge);
    for (int i = 0; i < BOARD_AXES; i++) {
        plant_drive_t *axis = &drive[i];
        if ((taken & (1u << i)) == 0u) {
            charge += axis_step(axis, plant->bus.u_dc, now_ns, plant->step_ns);
        } else if (plant_encoder_leaves(&axis->encoder, axis->motor.theta)) {
            const plant_movement_t movement = {
                theta[i], axis->motor.theta, omega[i], axis->motor.omega, 0.0, (double)plant->step_ns,
            };
            plant_encoder_move(&axis->encoder, &movement, now_ns);
        }
    }
    plant_bus_step(&plant->bus, charge * plant->steps_per_second);
}

void plant_half_cycle(plant_t *plant)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        plant_drive_t *axis = &plant->axis[i];
        for (int k = 0; k < 3; k++) {
            axis->voltage[k] = axis->voltage_sum[k] * (1.0 / PLANT_STEPS_PER_HALF);
            axis->voltage_sum[k] = 0.0;
        }
    }
}

bool plant_over_current(const plant_t *plant, int axis)
{
    const plant_motor_t *motor = &plant->axis[axis].motor;
    const double *phase = motor->phase;
    const double most = plant->axis[axis].config.i_break;
    if (motor->i_d * motor->i_d + motor->i_q * motor->i_q < most * most) { /* no phase is larger than the vector */
        return false;
    }
    return phase[0] > most || phase[1] > most || phase[2] > most || phase[0] < -most || phase[1] < -most ||
           phase[2] < -most;
}

uint16_t plant_current_code(plant_t *plant, int axis, int phase, bool low_side_centre)
{
    plant_drive_t *drive = &plant->axis[axis];
    const double current = plant_inverter_shunt(&drive->inverter, &drive->motor, phase, low_side_centre);
    const double shown =
        current + drive->config.i_offset[phase] + drive->config.i_noise * plant_random_gauss(&drive->noise);
    return plant_code(2048.0 + shown * drive->codes_per_ampere);
}

uint16_t plant_bus_code(plant_t *plant)
{
    const double shown = plant->bus.u_dc + plant->bus_config.u_noise * plant_random_gauss(&plant->bus_noise);
    return plant_code(shown * plant->codes_per_volt);
}

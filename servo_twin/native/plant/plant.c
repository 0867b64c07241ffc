#include "plant/plant.h"

#include <math.h>

#include "plant/inline.h"

static inline motor_lane_t lane_of(plant_drive_t *axis) { return (motor_lane_t){&axis->inverter, &axis->motor}; }

static void update_pair(plant_t *plant)
{
    const motor_lane_t lane[2] = {lane_of(&plant->axis[0]), lane_of(&plant->axis[1])};
    motor_pair_init(&plant->pair, lane, plant->step);
}

void plant_init(plant_t *plant, const board_config_t *config)
{
    *plant = (plant_t){.u_noise = config->bus.u_noise, .u_noise_configured = config->bus.u_noise};
    plant->step_ns = (uint64_t)(0.5e9 / config->pwm_frequency + 0.5);
    const double step = (double)plant->step_ns * 1e-9;
    plant->step = step;
    plant->steps_per_second = 1.0 / step;
    supply_init(&plant->bus, &config->bus, config->ambient);
    plant_random_init(&plant->bus_noise, config->seed, 0);
    for (int i = 0; i < BOARD_AXES; i++) {
        plant_drive_t *axis = &plant->axis[i];
        axis->config = config->axis[i];
        averaged_inverter_init(&axis->inverter, &config->axis[i], config->pwm_frequency, step);
        plant_motor_init(&axis->motor, &config->axis[i]);
        plant_encoder_init(&axis->encoder, &config->axis[i]);
        plant_random_init(&axis->noise, config->seed, (uint64_t)i + 1u);
        plant_faults_init(&axis->faults, &config->axis[i], config->seed, (uint64_t)i + 5u);
        plant_pins_init(&axis->pins, &config->axis[i]);
        thermal_init(&axis->sink, config->axis[i].sink_capacity, config->axis[i].sink_resistance, config->ambient);
        thermal_init(&axis->winding, config->axis[i].winding_capacity, config->axis[i].winding_resistance,
                     config->ambient);
        axis->t_magnet = config->ambient;
    }
    plant_change(plant, config);
}

/* External torque, on the second mass if there is one [N m]. */
static void set_load(plant_drive_t *axis, double torque)
{
    axis->shaft.load = torque;
    axis->stop.load = axis->shaft.two_masses ? 0.0 : torque;
    axis->motor.load = axis->stop.load; /* the next step adds the torque of end stops, shaft and cogging */
}

double plant_resistance(const plant_drive_t *axis)
{
    return axis->config.winding_warms > 0.0 ? axis->config.r_s * thermal_copper(&axis->winding) : axis->config.r_s;
}

/* Update resistance and flux to the present temperatures. False if they do not depend on them. */
static bool apply_temperatures(plant_drive_t *axis)
{
    const plant_axis_t *c = &axis->config;
    if (c->winding_warms <= 0.0 && c->magnet_coefficient == 0.0) {
        return false;
    }
    const double psi_m = c->psi_m * (1.0 + c->magnet_coefficient * (axis->t_magnet - axis->winding.ambient));
    plant_motor_warm(&axis->motor, plant_resistance(axis), c->r_on, psi_m);
    return true;
}

static void set_inertia(plant_drive_t *axis)
{
    axis->motor.inv_inertia = axis->driven.on ? 0.0 : 1.0 / axis->config.inertia;
}

static void change_axis(plant_drive_t *axis, const plant_axis_t *config, double pwm_frequency, double step)
{
    const double noise = plant_faults_noise(&axis->faults.i_noise_configured, axis->config.i_noise, config->i_noise);
    axis->config = *config;
    axis->config.i_noise = noise;
    averaged_inverter_change(&axis->inverter, config, pwm_frequency, step);
    plant_motor_change(&axis->motor, config);
    set_inertia(axis);
    plant_pins_change(&axis->pins, config);
    axis->motor.friction = plant_pins_friction(&axis->pins);
    const double part = step / PLANT_SHAFT_STEPS;
    shaft_change(&axis->shaft, config, axis->motor.theta, axis->motor.omega);
    plant_motor_set_fine(&axis->motor, axis->shaft.fine);
    axis->stop = end_stop_of(config, axis->shaft.fine ? part : step);
    set_load(axis, config->load_torque);
    plant_encoder_change(&axis->encoder, config);
    axis->codes_per_ampere = 2048.0 / config->i_full_scale;
    thermal_change(&axis->sink, config->sink_capacity, config->sink_resistance);
    thermal_change(&axis->winding, config->winding_capacity, config->winding_resistance);
    axis->magnet_share = thermal_magnet(step * PLANT_THERMAL_STEPS, config->magnet_time);
    apply_temperatures(axis);
}

void plant_change(plant_t *plant, const board_config_t *config)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        change_axis(&plant->axis[i], &config->axis[i], config->pwm_frequency, plant->step);
    }
    plant->u_noise = plant_faults_noise(&plant->u_noise_configured, plant->u_noise, config->bus.u_noise);
    plant->codes_per_volt = 4096.0 / config->bus.u_full_scale;
    supply_change(&plant->bus, &config->bus);
    plant->bus_step = supply_step_of(&plant->bus, plant->step);
    update_pair(plant);
}

/* The encoder follows a movement. */
static inline void follow(plant_drive_t *axis, const plant_movement_t *movement, uint64_t now_ns)
{
    if (!plant_encoder_leaves(&axis->encoder, movement->theta_1)) {
        return;
    }
    if (shaft_too_fast(movement->omega_1, movement->theta_1)) {
        axis->too_fast = true;
    } else if (axis->encoder.armed) {
        plant_encoder_move(&axis->encoder, movement, now_ns);
    } else {
        plant_encoder_count(&axis->encoder, movement->theta_1);
    }
}

/* Step of one axis: `step` [ns] from `start` [ns] within the step of the plant. Returns the charge drawn from the bus [A s]. */
static double step_axis(plant_drive_t *axis, double u_dc, uint64_t now_ns, double start, double step)
{
    plant_motor_t *motor = &axis->motor;
    double done = 0.0; /* [ns] */
    double charge = 0.0;
    while (done < step) {
        plant_movement_t movement = {.theta_0 = motor->theta, .omega_0 = motor->omega, .start_ns = start + done};
        const double rest = step - done;
        const double used = 1e9 * averaged_inverter_step(&axis->inverter, motor, u_dc, 1e-9 * rest, &charge);
        movement.duration_ns = used;
        movement.theta_1 = motor->theta;
        movement.omega_1 = motor->omega;
        follow(axis, &movement, now_ns);
        /* a rest below half a nanosecond is rounding */
        done = (rest - used < 0.5) ? step : done + used;
    }
    return charge;
}

/* A whole step in parts, each with the torque of shaft, cogging and end stops in its middle. */
static PLANT_COLD double step_axis_finely(plant_drive_t *axis, double u_dc, uint64_t now_ns, double step)
{
    const double part = step / PLANT_SHAFT_STEPS;
    double charge = 0.0;
    for (int n = 0; n < PLANT_SHAFT_STEPS; n++) {
        plant_motor_t *motor = &axis->motor;
        motor->load = end_stop_load(&axis->stop, motor->theta, motor->omega) +
                      shaft_step(&axis->shaft, motor->theta, motor->omega, 1e-9 * part);
        charge += step_axis(axis, u_dc, now_ns, n * part, part);
    }
    return charge;
}

/* Random pulses on the encoder lines. */
static void inject_glitches(plant_drive_t *axis, double step, uint64_t now_ns)
{
    for (int line = 0; line < PLANT_ENCODER_LINES; line++) {
        const double rate = axis->faults.glitches[line];
        if (rate > 0.0 && plant_faults_uniform(&axis->faults) < rate * step) {
            plant_encoder_glitch(&axis->encoder, (plant_line_t)line, now_ns);
        }
    }
}

static void update_temperatures(plant_t *plant)
{
    const double h = plant->step * PLANT_THERMAL_STEPS;
    bool changed = false;
    for (int i = 0; i < BOARD_AXES; i++) {
        plant_drive_t *axis = &plant->axis[i];
        if (!axis->faults.sink_held) {
            thermal_advance(&axis->sink, h, axis->inverter.heat);
        }
        axis->inverter.heat = 0.0;
        const plant_motor_t *m = &axis->motor;
        const double loss =
            1.5 * axis->config.r_s * thermal_copper(&axis->winding) * (m->i_d * m->i_d + m->i_q * m->i_q);
        thermal_advance(&axis->winding, h, loss * h);
        axis->t_magnet += axis->magnet_share * (axis->winding.t - axis->t_magnet);
        changed = apply_temperatures(axis) || changed;
    }
    if (changed) {
        update_pair(plant);
    }
    supply_warm(&plant->bus, h);
}

PLANT_NOINLINE void plant_step(plant_t *plant, uint64_t now_ns)
{
    plant_drive_t *drive = plant->axis;
    const motor_lane_t lane[2] = {lane_of(&drive[0]), lane_of(&drive[1])};
    const double theta[2] = {drive[0].motor.theta, drive[1].motor.theta};
    for (int i = 0; i < BOARD_AXES; i++) {
        if (drive[i].driven.on) {
            drive[i].motor.omega = driven_shaft_step(&drive[i].driven, theta[i], plant->step);
        }
    }
    const double omega[2] = {drive[0].motor.omega, drive[1].motor.omega};
    double charge;
    for (int i = 0; i < BOARD_AXES; i++) {
        if (drive[i].stop.stiffness > 0.0) {
            drive[i].motor.load = end_stop_load(&drive[i].stop, theta[i], omega[i]);
        }
    }
    plant->u_step = plant->bus.u;
    const unsigned taken = motor_pair_step(&plant->pair, lane, plant->bus.u, &charge);
    for (int i = 0; i < BOARD_AXES; i++) {
        plant_drive_t *axis = &drive[i];
        if ((taken & (1u << i)) == 0u) {
            charge += axis->shaft.fine ? step_axis_finely(axis, plant->bus.u, now_ns, (double)plant->step_ns)
                                       : step_axis(axis, plant->bus.u, now_ns, 0.0, (double)plant->step_ns);
        } else {
            const plant_movement_t movement = {
                theta[i], axis->motor.theta, omega[i], axis->motor.omega, 0.0, (double)plant->step_ns,
            };
            follow(axis, &movement, now_ns);
        }
        if (axis->faults.has_glitches) {
            inject_glitches(axis, plant->step, now_ns);
        }
        const double torque = plant_motor_torque(&axis->motor);
        axis->impulse += (0.5 * plant->step) * (axis->torque + torque);
        axis->torque = torque;
    }
    (void)supply_take_step(&plant->bus, &plant->bus_step, charge * plant->steps_per_second);
    if (++plant->steps == PLANT_THERMAL_STEPS) {
        plant->steps = 0;
        update_temperatures(plant);
    }
}

void plant_set_load(plant_t *plant, int axis, double torque) { set_load(&plant->axis[axis], torque); }

void plant_drive_shaft(plant_t *plant, int i, double theta, double omega, double duration, double late)
{
    plant_drive_t *axis = &plant->axis[i];
    plant_motor_t *motor = &axis->motor;
    plant_motor_lock(motor, false);
    plant_motor_obstruct(motor, INFINITY, INFINITY);
    driven_shaft_begin(&axis->driven, motor->theta, motor->omega, theta, omega, duration, late);
    set_inertia(axis);
    update_pair(plant);
}

void plant_release_shaft(plant_t *plant, int i)
{
    plant_drive_t *axis = &plant->axis[i];
    if (axis->driven.on) {
        axis->motor.omega = driven_shaft_speed(&axis->driven);
        axis->driven.on = false;
        set_inertia(axis);
        update_pair(plant);
    }
}

void plant_voltages(const plant_t *plant, int axis, double voltage[3])
{
    const plant_drive_t *drive = &plant->axis[axis];
    averaged_inverter_voltages(&drive->inverter, &drive->motor, plant->u_step, voltage);
}

bool plant_over_current(const plant_t *plant, int axis)
{
    const plant_motor_t *motor = &plant->axis[axis].motor;
    const averaged_inverter_t *inverter = &plant->axis[axis].inverter;
    const double *phase = motor->phase;
    const double i_max = plant->axis[axis].config.i_break;
    if (inverter->has_fault && averaged_inverter_shorted(inverter)) { /* its current exceeds any threshold */
        return true;
    }
    if (motor->i_d * motor->i_d + motor->i_q * motor->i_q < i_max * i_max) { /* no phase exceeds the vector */
        return false;
    }
    return phase[0] > i_max || phase[1] > i_max || phase[2] > i_max || phase[0] < -i_max || phase[1] < -i_max ||
           phase[2] < -i_max;
}

uint16_t plant_bus_code(plant_t *plant)
{
    const double shown = plant->bus.u + plant->u_noise * plant_random_gauss(&plant->bus_noise);
    return plant_code(shown * plant->codes_per_volt);
}

uint16_t plant_sink_code(const plant_t *plant, int axis) { return plant_code_sink(plant->axis[axis].sink.t); }

void plant_update_holding_brakes(plant_t *plant, double now)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        plant_drive_t *axis = &plant->axis[i];
        if (plant_pins_follow(&axis->pins, now)) {
            axis->motor.friction = plant_pins_friction(&axis->pins);
        }
    }
}

static void set_converter_fault(plant_drive_t *axis, const board_fault_t *fault, bool cleared)
{
    axis->faults.stuck[fault->part] = !cleared;
    axis->faults.code[fault->part] = plant_code(fault->value);
}

static void set_supply_fault(plant_t *plant, const board_fault_t *fault, bool cleared)
{
    if (cleared) {
        supply_recover(&plant->bus);
    } else {
        supply_dip(&plant->bus, fault->value, fault->seconds);
    }
}

void plant_set_fault(plant_t *plant, const board_fault_t *fault, bool cleared)
{
    plant_drive_t *axis = &plant->axis[fault->axis];
    switch ((board_fault_kind_t)fault->kind) {
    case BOARD_OPEN_PHASE:
        averaged_inverter_open(&axis->inverter, &axis->motor, fault->part, !cleared);
        break;
    case BOARD_SHORTED_PHASE:
        averaged_inverter_short(&axis->inverter, cleared ? PLANT_NO_SHORT : fault->part, (int)fault->value);
        break;
    case BOARD_STUCK_CONVERTER:
        set_converter_fault(axis, fault, cleared);
        break;
    case BOARD_STUCK_LINE:
        plant_encoder_stick(&axis->encoder, (plant_line_t)fault->part, !cleared, fault->value != 0.0);
        break;
    case BOARD_LOCKED_ROTOR:
        plant_motor_lock(&axis->motor, !cleared);
        break;
    case BOARD_SUPPLY_DIP:
        set_supply_fault(plant, fault, cleared);
        break;
    case BOARD_CURRENT_NOISE:
        axis->config.i_noise = cleared ? axis->faults.i_noise_configured : fault->value;
        break;
    case BOARD_BUS_NOISE:
        plant->u_noise = cleared ? plant->u_noise_configured : fault->value;
        break;
    case BOARD_ENCODER_GLITCHES:
        axis->faults.glitches[fault->part] = cleared ? 0.0 : fault->value;
        axis->faults.has_glitches =
            axis->faults.glitches[PLANT_LINE_A] > 0.0 || axis->faults.glitches[PLANT_LINE_B] > 0.0;
        break;
    case BOARD_STALLED_CORE:
        break; /* not part of the plant */
    case BOARD_HEAT:
        axis->faults.sink_held = !cleared;
        axis->sink.t = cleared ? axis->sink.t : fault->value;
        break;
    case BOARD_CUT_WIRE:
        break; /* handled by the board, which knows the time */
    case BOARD_SLIPPED_ENCODER:
        plant_encoder_slip(&axis->encoder, cleared ? 0 : (int)fault->value);
        break;
    }
}

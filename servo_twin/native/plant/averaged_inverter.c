#include "plant/averaged_inverter.h"

#include <math.h>
#include <string.h>

#include "plant/trig.h"

/* Sweeps of the complementarity solver, each of which reduces the error to a quarter, and its tolerance. */
#define SWEEPS_MAX 40
#define TOLERANCE 1e-9 /* [V] */

#define NUM double
#define KERNEL(name) single_##name
#define LIMIT(x, low, high) plant_limit(x, low, high)
#include "plant/averaged_kernel.h"

static inline double larger(double x, double y) { return (x > y) ? x : y; }

void averaged_inverter_change(averaged_inverter_t *inverter, const plant_axis_t *config, double pwm_frequency,
                              double step)
{
    const double l = (config->l_d < config->l_q) ? config->l_d : config->l_q;
    /* s(i) has the slope 1.5 / i_w at zero and is constant over a step. For a stable step a current must not cross zero by
     * more than a quarter of its size: 1.5 E step / (L i_w) <= 1.25 with the error voltage E. */
    const double per_error_volt = 1.2 * step / l;
    inverter->dead_part = config->dead_time * pwm_frequency;
    inverter->v_drop = config->v_drop;
    inverter->r_on = config->r_on;
    inverter->band_dead = config->dead_time / l;
    inverter->band_ripple = 1.0 / (6.0 * pwm_frequency * l);
    inverter->floor_dead = per_error_volt * config->dead_time * pwm_frequency;
    inverter->floor_drop = per_error_volt * config->v_drop + 1e-6;
}

void averaged_inverter_init(averaged_inverter_t *inverter, const plant_axis_t *config, double pwm_frequency,
                            double step)
{
    *inverter = (averaged_inverter_t){.inv_i_w = 1.0, .short_from = PLANT_NO_SHORT};
    averaged_inverter_change(inverter, config, pwm_frequency, step);
}

void averaged_inverter_load(averaged_inverter_t *inverter, const double duty[3], double u_dc)
{
    for (int k = 0; k < 3; k++) {
        inverter->duty[k] = duty[k];
        inverter->dead_leg[k] = (duty[k] > 0.0 && duty[k] < 1.0) ? inverter->dead_part : 0.0;
    }
    const double high = larger(duty[0], larger(duty[1], duty[2]));
    const double low = -larger(-duty[0], larger(-duty[1], -duty[2]));
    const double spread = (high - low) * (1.0 - (high - low));
    const double band = u_dc * (inverter->band_dead + inverter->band_ripple * spread);
    const double floor = u_dc * inverter->floor_dead + inverter->floor_drop;
    inverter->inv_i_w = 1.0 / larger(band, floor);
}

static void drive_legs(averaged_inverter_t *inverter, const plant_motor_t *motor, double u_dc)
{
    for (int k = 0; k < 3; k++) {
        inverter->share[k] = single_drive_leg(motor->phase[k], inverter->inv_i_w, inverter->duty[k],
                                              inverter->dead_leg[k], inverter->v_drop, u_dc, &inverter->leg[k]);
    }
}

/* Change of the phase currents per volt on each leg in a step of h seconds [A/V]: h C+ L^-1 C, symmetric, singular in the
 * common mode. */
static void admittance(const plant_motor_t *motor, double h, double a[3][3])
{
    const double mean = 0.5 * (motor->inv_l_d + motor->inv_l_q);
    const double half = 0.5 * (motor->inv_l_d - motor->inv_l_q);
    const double cosine2 = motor->cosine * motor->cosine - motor->sine * motor->sine;
    const double sine2 = 2.0 * motor->sine * motor->cosine;
    const double aa = mean + half * cosine2;
    const double ab = half * sine2;
    const double bb = mean - half * cosine2;
    static const double axis[3][2] = {{1.0, 0.0}, {-0.5, 0.5 * PLANT_SQRT3}, {-0.5, -0.5 * PLANT_SQRT3}};
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            a[i][j] =
                h * (2.0 / 3.0) *
                (axis[i][0] * (aa * axis[j][0] + ab * axis[j][1]) + axis[i][1] * (ab * axis[j][0] + bb * axis[j][1]));
        }
    }
}

/* Change of a phase current by the leg voltages v instead of `base`; `row` is that of the phase in the admittance. */
static double current_change(const double row[3], const double v[3], const double base[3])
{
    return row[0] * (v[0] - base[0]) + row[1] * (v[1] - base[1]) + row[2] * (v[2] - base[2]);
}

/* Terminals of the motor in a step. */
typedef struct {
    int first_phase[3]; /* number of the terminal of a phase: the first phase connected to it */
    double low[3], high[3]; /* limits of a terminal's voltage, equal if the voltage is given [V] */
} terminals_t;

static bool floats(const terminals_t *t, int n, const double v[3]) { return v[n] > t->low[n] && v[n] < t->high[n]; }

static void terminals_of(const averaged_inverter_t *inverter, double u_dc, terminals_t *t)
{
    for (int k = 0; k < 3; k++) {
        t->first_phase[k] = k;
        t->low[k] = inverter->on ? inverter->leg[k] : -inverter->v_drop;
        t->high[k] = inverter->on ? inverter->leg[k] : u_dc + inverter->v_drop;
        if (inverter->open[k]) {
            t->low[k] = -INFINITY;
            t->high[k] = INFINITY;
        }
    }
    const int from = inverter->short_from;
    const int to = inverter->short_to;
    if (from == PLANT_NO_SHORT || inverter->open[from]) {
        return;
    }
    if (to == PLANT_BUS_MINUS) {
        t->low[from] = 0.0;
        t->high[from] = 0.0;
    } else if (!inverter->open[to]) {
        const int first = (from < to) ? from : to;
        t->first_phase[from] = t->first_phase[to] = first;
        t->low[first] = 0.5 * (t->low[from] + t->low[to]);
        t->high[first] = 0.5 * (t->high[from] + t->high[to]);
    }
}

/* Find leg voltages within their limits for which the currents i + a (v - base) satisfy the complementarity conditions of the
 * diodes; `v` holds the first estimate. Projected Gauss-Seidel: each sweep minimises a convex quadratic along every terminal. */
static void solve_diodes(double a[3][3], const double i[3], const double base[3], const terminals_t *t, double v[3])
{
    for (int sweep = 0; sweep < SWEEPS_MAX; sweep++) {
        double moved = 0.0;
        for (int n = 0; n < 3; n++) {
            double current = 0.0;
            double slope = 0.0;
            for (int k = n; k < 3; k++) {
                if (t->first_phase[k] == n) {
                    current += i[k] + current_change(a[k], v, base);
                    slope += a[k][k] + 2.0 * ((k != n) ? a[k][n] : 0.0);
                }
            }
            if (slope > 0.0) { /* a terminal has this number */
                const double next = plant_limit(v[n] - current / slope, t->low[n], t->high[n]);
                moved += fabs(next - v[n]);
                for (int k = n; k < 3; k++) {
                    v[k] = (t->first_phase[k] == n) ? next : v[k];
                }
            }
        }
        if (moved < TOLERANCE) {
            break;
        }
    }
}

/* Set the current of a terminal to zero; two phases connected to it may still exchange a current. */
static void cut_off(const terminals_t *t, int n, double i[3])
{
    double sum = 0.0;
    double phases = 0.0;
    for (int k = n; k < 3; k++) {
        sum += (t->first_phase[k] == n) ? i[k] : 0.0;
        phases += (t->first_phase[k] == n) ? 1.0 : 0.0;
    }
    for (int k = n; k < 3; k++) {
        i[k] -= (t->first_phase[k] == n) ? sum / phases : 0.0;
    }
}

/* Set the currents after the voltage correction v - base; a floating terminal carries none. */
static void settle_currents(plant_motor_t *motor, double a[3][3], const double base[3], const double v[3],
                            const terminals_t *t)
{
    double i[3];
    int conducting = 0;
    int last = 0;
    for (int k = 0; k < 3; k++) {
        i[k] = motor->phase[k] + current_change(a[k], v, base);
    }
    for (int n = 0; n < 3; n++) {
        if (t->first_phase[n] == n && !floats(t, n, v)) {
            conducting++;
            last = n;
        } else if (t->first_phase[n] == n) {
            cut_off(t, n, i);
        }
    }
    if (conducting <= 1) { /* a single terminal has no return path */
        cut_off(t, last, i);
    } else {
        i[last] = -(i[(last + 1) % 3] + i[(last + 2) % 3]); /* a floating leg stays exactly at zero */
    }
    plant_motor_set_phases(motor, i[0], i[1]);
}

static bool all_zero(const plant_motor_t *motor) { return motor->i_d == 0.0 && motor->i_q == 0.0; }

/* True if no diode conducts: the currents are zero, and a potential of the star point exists at which every terminal voltage
 * is within its limits. *star is that potential [V]. */
static bool non_conducting(const averaged_inverter_t *inverter, const plant_motor_t *motor, const double emf[3],
                           double u_dc, const terminals_t *t, double *star)
{
    double star_min = -INFINITY;
    double star_max = INFINITY;
    if (inverter->on || !all_zero(motor)) {
        return false;
    }
    for (int k = 0; k < 3; k++) {
        if (t->first_phase[k] != k) { /* two phases in a loop */
            return motor->omega == 0.0;
        }
        star_min = larger(star_min, t->low[k] - emf[k]);
        star_max = -larger(-star_max, emf[k] - t->high[k]);
    }
    *star = plant_limit(0.5 * u_dc, star_min, star_max);
    return star_min <= star_max;
}

/* Charge returned to the bus: the motor's energy less the loss in the diodes. The energy balance is correct even if a current
 * ends within the step, because v is the mean of the clamped and the floating voltage. */
static void return_charge(averaged_inverter_t *inverter, const double mean[3], double u_dc, double used,
                          const terminals_t *t, double *charge)
{
    double energy = 0.0;
    double charge_max = 0.0; /* of the upper diodes [A s] */
    for (int n = 0; n < 3; n++) {
        double current = 0.0;
        for (int k = n; k < 3; k++) {
            current += (t->first_phase[k] == n) ? mean[k] : 0.0;
        }
        const bool diodes = t->low[n] < t->high[n];
        inverter->share[n] = (diodes && current < 0.0) ? 1.0 : 0.0;
        energy += diodes ? (inverter->leg[n] * current + inverter->v_drop * fabs(current)) * used : 0.0;
        charge_max += (diodes && current < 0.0) ? -current * used : 0.0;
    }
    if (energy < 0.0) {
        *charge += (-energy < charge_max * u_dc) ? energy / u_dc : -charge_max;
    }
}

/* Loss of the phase currents in switches and diodes [W]. */
static double conduction_loss(const averaged_inverter_t *inverter, const double phase[3])
{
    double power = 0.0;
    for (int k = 0; k < 3; k++) {
        power += (inverter->v_drop + inverter->r_on * fabs(phase[k])) * fabs(phase[k]);
    }
    return power;
}

/* A step with open switches, broken wires or a short circuit. */
static double limited_step(averaged_inverter_t *inverter, plant_motor_t *motor, double u_dc, double dt, double *charge)
{
    double emf[3];
    double star = 0.0;
    double *v = inverter->leg;
    terminals_t t;
    terminals_of(inverter, u_dc, &t);
    plant_motor_back_emf(motor, emf);
    if (non_conducting(inverter, motor, emf, u_dc, &t, &star)) {
        for (int k = 0; k < 3; k++) {
            v[k] = star + emf[k];
            inverter->share[k] = 0.0;
        }
        return plant_motor_coast(motor, dt);
    }
    /* estimate the voltages from the state at the beginning, step the motor with them, then correct the rest */
    double a[3][3];
    double before[3];
    double base[3];
    admittance(motor, dt, a);
    for (int k = 0; k < 3; k++) {
        const int n = t.first_phase[k];
        before[k] = motor->phase[k];
        base[k] = emf[k]; /* at this voltage the currents only decay, slowly compared with the step */
        v[k] = (inverter->open[k] || before[k] == 0.0) ? plant_limit(0.5 * u_dc + emf[n], t.low[n], t.high[n])
               : (before[k] > 0.0)                     ? t.low[n]
                                                       : t.high[n];
        v[k] = (n != k) ? v[n] : v[k];
    }
    solve_diodes(a, before, base, &t, v);
    memcpy(base, v, sizeof base);
    const double used = plant_motor_step(motor, plant_clarke(v), dt);
    admittance(motor, used, a);
    solve_diodes(a, motor->phase, base, &t, v);
    settle_currents(motor, a, base, v, &t);
    double mean[3];
    for (int k = 0; k < 3; k++) {
        mean[k] = 0.5 * (before[k] + motor->phase[k]);
    }
    inverter->heat += conduction_loss(inverter, mean) * used;
    if (inverter->on) {
        for (int k = 0; k < 3; k++) {
            *charge += inverter->share[k] * mean[k] * used;
        }
    } else {
        return_charge(inverter, mean, u_dc, used, &t, charge);
    }
    return used;
}

static void update_fault(averaged_inverter_t *inverter)
{
    inverter->has_fault =
        inverter->open[0] || inverter->open[1] || inverter->open[2] || inverter->short_from != PLANT_NO_SHORT;
}

void averaged_inverter_open(averaged_inverter_t *inverter, plant_motor_t *motor, int phase, bool open)
{
    if (open && !inverter->open[phase]) { /* the other two take half of its current each */
        double i[3] = {motor->phase[0], motor->phase[1], motor->phase[2]};
        i[(phase + 1) % 3] += 0.5 * i[phase];
        i[(phase + 2) % 3] += 0.5 * i[phase];
        i[phase] = 0.0;
        plant_motor_set_phases(motor, i[0], i[1]);
    }
    inverter->open[phase] = open;
    update_fault(inverter);
}

void averaged_inverter_short(averaged_inverter_t *inverter, int phase, int to)
{
    inverter->short_from = phase;
    inverter->short_to = to;
    update_fault(inverter);
}

bool averaged_inverter_shorted(const averaged_inverter_t *inverter)
{
    const int from = inverter->short_from;
    if (from == PLANT_NO_SHORT || !inverter->on) {
        return false;
    }
    return (inverter->short_to == PLANT_BUS_MINUS) ? inverter->duty[from] > 0.0
                                                   : inverter->duty[from] != inverter->duty[inverter->short_to];
}

void averaged_inverter_plug(averaged_inverter_t *inverter, plant_motor_t *motor, bool plugged)
{
    inverter->unplugged = !plugged;
    if (!plugged) {
        plant_motor_set_phases(motor, 0.0, 0.0);
    }
}

/* A step with the motor cable disconnected. */
static double unplugged_step(averaged_inverter_t *inverter, plant_motor_t *motor, double u_dc, double dt)
{
    for (int k = 0; k < 3; k++) {
        inverter->share[k] = 0.0;
        inverter->leg[k] = (inverter->on ? inverter->duty[k] : 0.5) * u_dc;
    }
    return plant_motor_coast(motor, dt);
}

double averaged_inverter_step(averaged_inverter_t *inverter, plant_motor_t *motor, double u_dc, double dt,
                              double *charge)
{
    if (inverter->unplugged) {
        return unplugged_step(inverter, motor, u_dc, dt);
    }
    if (inverter->on) {
        drive_legs(inverter, motor, u_dc);
    }
    if (!inverter->on || inverter->has_fault) {
        return limited_step(inverter, motor, u_dc, dt, charge);
    }
    const double before[3] = {motor->phase[0], motor->phase[1], motor->phase[2]};
    const double used = plant_motor_step(motor, plant_clarke(inverter->leg), dt);
    for (int k = 0; k < 3; k++) {
        *charge += inverter->share[k] * 0.5 * (before[k] + motor->phase[k]) * used;
        inverter->heat += used * single_leg_loss(before[k], motor->phase[k], inverter->share[k], inverter->leg[k],
                                                 inverter->r_on, u_dc);
    }
    return used;
}

void averaged_inverter_voltages(const averaged_inverter_t *inverter, const plant_motor_t *motor, double u_dc,
                                double voltage[3])
{
    for (int k = 0; k < 3; k++) {
        voltage[k] = single_phase_voltage(inverter->leg[k], motor->phase[k], inverter->r_on, u_dc);
    }
}

/* Current of a leg [A]; two that are shorted to each other carry half of the sum each. */
static double leg_current(const averaged_inverter_t *inverter, const plant_motor_t *motor, int phase)
{
    const int from = inverter->short_from;
    const int to = inverter->short_to;
    if (from == PLANT_NO_SHORT || (phase != from && phase != to)) {
        return motor->phase[phase];
    }
    return (to == PLANT_BUS_MINUS) ? 0.0 : 0.5 * (motor->phase[from] + motor->phase[to]);
}

double averaged_inverter_general_shunt(const averaged_inverter_t *inverter, const plant_motor_t *motor, int phase,
                                       bool low_side_centre)
{
    const double current = leg_current(inverter, motor, phase);
    if (!inverter->on) {
        return (current > 0.0) ? current : 0.0; /* only the lower diode's current flows through the shunt */
    }
    return averaged_inverter_low_conducts(inverter, phase, low_side_centre) ? current : 0.0;
}

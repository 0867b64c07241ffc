#include "plant/inverter.h"

#include <math.h>
#include <string.h>

#include "plant/trig.h"

/* Sweeps of the complementarity solver; a step that needs more is as good as solved (the error shrinks by 4 each). */
#define SWEEPS 40
#define SETTLED 1e-9 /* [V] */

#define NUM double
#define KERNEL(name) single_##name
#define LIMIT(x, low, high) plant_limit(x, low, high)
#include "plant/averaged_kernel.h"

static inline double larger(double x, double y) { return (x > y) ? x : y; }

void plant_inverter_init(plant_inverter_t *inverter, const plant_axis_t *config, double pwm_frequency, double step)
{
    const double l = (config->l_d < config->l_q) ? config->l_d : config->l_q;
    /* s(i) has the slope 1.5 / i_w at zero. Held constant over a step it must not carry a current past zero to more
     * than a quarter of its mirror image: 1.5 E step / (L i_w) <= 1.25 with the error voltage E. */
    const double reach = 1.2 * step / l;
    *inverter = (plant_inverter_t){
        .dead = config->dead_time * pwm_frequency,
        .v_drop = config->v_drop,
        .r_on = config->r_on,
        .band_dead = config->dead_time / l,
        .band_ripple = 1.0 / (6.0 * pwm_frequency * l),
        .floor_dead = reach * config->dead_time * pwm_frequency,
        .floor_drop = reach * config->v_drop + 1e-6,
        .inv_i_w = 1.0,
    };
}

void plant_inverter_load(plant_inverter_t *inverter, const double duty[3], double u_dc)
{
    for (int k = 0; k < 3; k++) {
        inverter->duty[k] = duty[k];
        inverter->dead_leg[k] = (duty[k] > 0.0 && duty[k] < 1.0) ? inverter->dead : 0.0;
    }
    const double high = larger(duty[0], larger(duty[1], duty[2]));
    const double low = -larger(-duty[0], larger(-duty[1], -duty[2]));
    const double spread = (high - low) * (1.0 - (high - low));
    const double band = u_dc * (inverter->band_dead + inverter->band_ripple * spread);
    const double floor = u_dc * inverter->floor_dead + inverter->floor_drop;
    inverter->inv_i_w = 1.0 / larger(band, floor);
}

static void drive_legs(plant_inverter_t *inverter, const plant_motor_t *motor, double u_dc)
{
    for (int k = 0; k < 3; k++) {
        inverter->share[k] = single_drive_leg(motor->phase[k], inverter->inv_i_w, inverter->duty[k],
                                              inverter->dead_leg[k], inverter->v_drop, u_dc, &inverter->leg[k]);
    }
}

/* Change of the phase currents by one volt for one step on each leg: h C+ L^-1 C, symmetric, singular in the common
 * mode. */
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

static double change_of(const double row[3], const double v[3], const double base[3])
{
    return row[0] * (v[0] - base[0]) + row[1] * (v[1] - base[1]) + row[2] * (v[2] - base[2]);
}

/* Leg voltages in [low, high] such that the currents `i` + a (v - base) agree with the diodes; `v` is the first guess.
 * Projected Gauss-Seidel: each sweep is one exact minimisation along every leg of a convex quadratic. */
static void solve_diodes(double a[3][3], const double i[3], const double base[3], double low, double high, double v[3])
{
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        double moved = 0.0;
        for (int k = 0; k < 3; k++) {
            const double current = i[k] + change_of(a[k], v, base);
            const double next = plant_limit(v[k] - current / a[k][k], low, high);
            moved += fabs(next - v[k]);
            v[k] = next;
        }
        if (moved < SETTLED) {
            break;
        }
    }
}

/* Currents after the correction v - base; a leg that floats carries none. */
static void settle_currents(plant_motor_t *motor, double a[3][3], const double base[3], const double v[3], double low,
                            double high)
{
    double i[3];
    int floating = 0;
    int last = 0;
    for (int k = 0; k < 3; k++) {
        i[k] = motor->phase[k] + change_of(a[k], v, base);
        if (v[k] > low && v[k] < high) {
            i[k] = 0.0;
            floating++;
        } else {
            last = k;
        }
    }
    if (floating >= 2) { /* one leg alone has no way back */
        plant_motor_set_phases(motor, 0.0, 0.0);
    } else {
        i[last] = -(i[(last + 1) % 3] + i[(last + 2) % 3]); /* a floating leg stays exactly at zero */
        plant_motor_set_phases(motor, i[0], i[1]);
    }
}

static bool all_zero(const plant_motor_t *motor) { return motor->i_d == 0.0 && motor->i_q == 0.0; }

/* Six open switches. */
static double open_step(plant_inverter_t *inverter, plant_motor_t *motor, double u_dc, double dt, double *charge)
{
    const double low = -inverter->v_drop;
    const double high = u_dc + inverter->v_drop;
    double emf[3];
    plant_motor_back_emf(motor, emf);
    double *v = inverter->leg;
    if (all_zero(motor)) {
        const double top = larger(emf[0], larger(emf[1], emf[2]));
        const double depth = larger(-emf[0], larger(-emf[1], -emf[2]));
        if (top + depth <= high - low) {
            for (int k = 0; k < 3; k++) {
                v[k] = 0.5 * u_dc + emf[k];
                inverter->share[k] = 0.0;
            }
            return plant_motor_coast(motor, dt);
        }
    }
    /* estimate the voltages from the beginning of the step, run the motor on them, then settle what is left over */
    double a[3][3];
    double before[3];
    double base[3];
    admittance(motor, dt, a);
    for (int k = 0; k < 3; k++) {
        before[k] = motor->phase[k];
        base[k] = emf[k]; /* at this voltage the currents only decay, slowly against the step */
        v[k] = (before[k] > 0.0) ? low : (before[k] < 0.0) ? high : plant_limit(0.5 * u_dc + emf[k], low, high);
    }
    solve_diodes(a, before, base, low, high, v);
    memcpy(base, v, sizeof base);
    const double used = plant_motor_step(motor, plant_clarke(v), dt);
    admittance(motor, used, a);
    solve_diodes(a, motor->phase, base, low, high, v);
    settle_currents(motor, a, base, v, low, high);
    /* What the motor gives and the diodes do not burn goes into the bus. Counting energy is right even where a current
     * dies within the step, because v is the mean of clamped and floating. */
    double energy = 0.0;
    double most = 0.0; /* the upper diodes carry no more than this */
    for (int k = 0; k < 3; k++) {
        const double mean = 0.5 * (before[k] + motor->phase[k]);
        energy += (v[k] * mean + inverter->v_drop * fabs(mean)) * used;
        most += (mean < 0.0) ? -mean * used : 0.0;
        inverter->share[k] = (mean < 0.0) ? 1.0 : 0.0;
    }
    if (energy < 0.0) {
        *charge += (-energy < most * u_dc) ? energy / u_dc : -most;
    }
    return used;
}

void plant_inverter_plug(plant_inverter_t *inverter, plant_motor_t *motor, bool plugged)
{
    inverter->unplugged = !plugged;
    if (!plugged) {
        plant_motor_set_phases(motor, 0.0, 0.0);
    }
}

/* Legs without a load. */
static double unplugged_step(plant_inverter_t *inverter, plant_motor_t *motor, double u_dc, double dt)
{
    for (int k = 0; k < 3; k++) {
        inverter->share[k] = 0.0;
        inverter->leg[k] = (inverter->on ? inverter->duty[k] : 0.5) * u_dc;
    }
    return plant_motor_coast(motor, dt);
}

double plant_inverter_step(plant_inverter_t *inverter, plant_motor_t *motor, double u_dc, double dt, double *charge)
{
    if (inverter->unplugged) {
        return unplugged_step(inverter, motor, u_dc, dt);
    }
    if (!inverter->on) {
        return open_step(inverter, motor, u_dc, dt, charge);
    }
    drive_legs(inverter, motor, u_dc);
    const double before[3] = {motor->phase[0], motor->phase[1], motor->phase[2]};
    const double used = plant_motor_step(motor, plant_clarke(inverter->leg), dt);
    for (int k = 0; k < 3; k++) {
        *charge += inverter->share[k] * 0.5 * (before[k] + motor->phase[k]) * used;
    }
    return used;
}

double plant_inverter_shunt(const plant_inverter_t *inverter, const plant_motor_t *motor, int phase,
                            bool low_side_centre)
{
    const double current = motor->phase[phase];
    if (!inverter->on) {
        return (current > 0.0) ? current : 0.0; /* only the lower diode passes the shunt */
    }
    /* the switch of the other side takes the current away whenever it is on at all around this centre */
    const double share = inverter->share[phase];
    const bool low_conducts = low_side_centre ? share < 1.0 : share <= 0.0;
    return low_conducts ? current : 0.0;
}

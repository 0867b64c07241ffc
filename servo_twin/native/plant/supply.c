#include "plant/supply.h"

#include "plant/decay.h"

#define SERIES_MAX 0.125 /* largest x for the series of e^-x */

static void update_regular(supply_t *s) { s->regular = (s->braking || s->dip > 0.0) ? 0.0 : SERIES_MAX; }

void supply_change(supply_t *supply, const plant_bus_t *config)
{
    supply->g_source = 1.0 / config->r_source;
    supply->g_brake = (config->r_brake > 0.0) ? 1.0 / config->r_brake : 0.0;
    supply->c = config->capacitance;
    supply->inv_c = 1.0 / config->capacitance;
    supply->per_rc = 1.0 / (config->r_source * config->capacitance);
    supply_set(supply, config->u_source);
    thermal_change(&supply->brake_resistor, config->brake_capacity, config->brake_resistance);
}

void supply_init(supply_t *supply, const plant_bus_t *config, double ambient)
{
    *supply = (supply_t){.u = config->u_source};
    thermal_init(&supply->brake_resistor, config->brake_capacity, config->brake_resistance, ambient);
    supply_change(supply, config);
    update_regular(supply);
}

void supply_switch(supply_t *supply, bool braking)
{
    supply->braking = braking;
    update_regular(supply);
}

void supply_set(supply_t *supply, double volts)
{
    supply->u_nominal = volts;
    if (supply->dip <= 0.0) {
        supply->u_source = volts;
    }
}

void supply_dip(supply_t *supply, double volts, double seconds)
{
    supply->u_source = volts;
    supply->dip = seconds;
    update_regular(supply);
}

void supply_recover(supply_t *supply)
{
    supply->u_source = supply->u_nominal;
    supply->dip = 0.0;
    update_regular(supply);
}

void supply_warm(supply_t *supply, double h)
{
    thermal_advance(&supply->brake_resistor, h, supply->e_brake - supply->e_warm);
    supply->e_warm = supply->e_brake;
}

/* Step with the source conducting all the time, or not at all: u' = (i - g u) / C. Returns the voltage at the end. */
static inline double solve_step(supply_t *s, double h, double i_load, bool conducts, double *u_h)
{
    const double g_brake = s->braking ? s->g_brake : 0.0;
    const double g = conducts ? s->g_source + g_brake : g_brake;
    const double i = conducts ? s->g_source * s->u_source - i_load : -i_load;
    const double x = h * g * s->inv_c;
    const double rise = h * (i - g * s->u) * s->inv_c; /* with the slope at the beginning */
    if (x < SERIES_MAX) { /* (1 - e^-x) / x and (x - 1 + e^-x) / x^2 */
        *u_h = h * (s->u + rise * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0)))));
        return s->u + rise * (1.0 - x * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0))));
    }
    const double y = plant_one_minus_decay(x);
    *u_h = h * (s->u + rise * (x - y) / (x * x));
    return s->u + rise * y / x;
}

/* Account a part of a step that ends at the voltage `u` [V] and has the integral `u_h` [V s]. */
static inline void account_step(supply_t *s, double h, double u, double u_h, double i_load, bool conducts)
{
    const double mean = 0.5 * (s->u + u);
    const double q_brake = s->braking ? s->g_brake * u_h : 0.0;
    if (conducts) { /* charge from the source by charge balance */
        s->e_source += mean * ((u - s->u) * s->c + q_brake + i_load * h);
    }
    s->e_brake += mean * q_brake;
    s->u = u;
}

/* Time at which the bus crosses the voltage of the source in a step that ends at `u`: from the chord, refined by the slope there,
 * which is the same with and without the source. */
static double source_crossing(supply_t *s, double h, double i_load, bool conducts, double u)
{
    const double g_brake = s->braking ? s->g_brake : 0.0;
    const double slope = -(i_load + g_brake * s->u_source) * s->inv_c;
    double part = h * (s->u_source - s->u) / (u - s->u);
    for (int n = 0; n < 2 && slope != 0.0; n++) {
        double u_h;
        const double next = part + (s->u_source - solve_step(s, part, i_load, conducts, &u_h)) / slope;
        if (!(next > 0.0 && next < h)) {
            break;
        }
        part = next;
    }
    return part;
}

double supply_advance_general(supply_t *s, double h, double i_load)
{
    if (s->dip > 0.0) {
        s->dip -= h;
        if (s->dip <= 0.0) {
            supply_recover(s);
        }
    }
    const bool conducts = s->u < s->u_source || (s->u == s->u_source && i_load > 0.0);
    double u_h;
    double u = solve_step(s, h, i_load, conducts, &u_h);
    if (conducts ? u > s->u_source : u < s->u_source) {
        const double part = source_crossing(s, h, i_load, conducts, u);
        double first_h = 0.0;
        if (part > 0.0) {
            (void)solve_step(s, part, i_load, conducts, &first_h);
            account_step(s, part, s->u_source, first_h, i_load, conducts);
        }
        s->u = s->u_source;
        u = solve_step(s, h - part, i_load, !conducts, &u_h);
        if (h > part) {
            account_step(s, h - part, u, u_h, i_load, !conducts);
        }
        u_h += first_h;
    } else {
        account_step(s, h, u, u_h, i_load, conducts);
    }
    if (s->u < 0.0) {
        s->u = 0.0;
    }
    return u_h;
}

double supply_advance(supply_t *s, double h, double i_load)
{
    const supply_step_t step = supply_step_of(s, h);
    return supply_take_step(s, &step, i_load);
}

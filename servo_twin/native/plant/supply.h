/* supply.h - the DC bus: source, capacitor, brake resistor.
 *
 *   C du/dt = i_source - u / R_brake - i_load,   i_source = max(0, (u_source - u) / R)
 * The source is a rectifier: energy returned by braking motors stays in the capacitor. Exact while the load is constant, also
 * if the rectifier begins or ceases to conduct within a step.
 */
#ifndef PLANT_SUPPLY_H
#define PLANT_SUPPLY_H

#include <stdbool.h>

#include "board.h"
#include "plant/thermal.h"

typedef struct {
    double u_source;  /* open-circuit voltage [V] */
    double u_nominal;   /* u_source after a dip [V] */
    double dip;       /* remaining time of a dip; 0: no dip [s] */
    double g_source;  /* conductance of the source [S] */
    double g_brake;   /* conductance of the brake resistor; 0: no resistor [S] */
    double c, inv_c;  /* capacitance and its inverse [F], [1/F] */
    double per_rc;    /* 1 / (R C) of the source [1/s] */
    bool braking;     /* the brake resistor is switched on */
    double regular;   /* longest step of the fast path, in R C [1]; 0 during braking and dips */
    double u;         /* bus voltage [V] */
    double e_source;  /* delivered by the source into the bus so far [J] */
    double e_brake;   /* dissipated in the brake resistor so far [J] */
    double e_warm;    /* part of it that the temperature already includes [J] */
    thermal_t brake_resistor;
} supply_t;

/* Constants of a step length while the source conducts. */
typedef struct {
    double h;          /* [s] */
    double x;          /* h / (R C) [1] */
    double end, mean;  /* (1 - e^-x) / x, (x - 1 + e^-x) / x^2 [1] */
} supply_step_t;

static inline supply_step_t supply_step_of(const supply_t *supply, double h)
{
    const double x = h * supply->per_rc;
    return (supply_step_t){
        .h = h,
        .x = x,
        .end = 1.0 - x * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0))),
        .mean = 0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0)),
    };
}

/* With the bus charged to the voltage of the source; `ambient` [deg C]. */
void supply_init(supply_t *supply, const plant_bus_t *config, double ambient);

/* Advance by `h` seconds with the load current `i_load` [A], in general: also if the source begins or ceases to conduct, during
 * braking, with a source of low resistance. Returns the integral of the bus voltage [V s]. */
double supply_advance_general(supply_t *supply, double h, double i_load);

/* The same, with a fast path for steps in which the source conducts all the time. */
static inline double supply_take_step(supply_t *s, const supply_step_t *step, double i_load)
{
    const double h = step->h;
    const double rise = h * s->inv_c * (s->g_source * (s->u_source - s->u) - i_load);
    const double u = s->u + rise * step->end;
    if (s->u < s->u_source && u < s->u_source && u > 0.0 && step->x < s->regular) {
        const double u_h = h * (s->u + rise * step->mean);
        s->e_source += 0.5 * (s->u + u) * ((u - s->u) * s->c + i_load * h);
        s->u = u;
        return u_h;
    }
    return supply_advance_general(s, h, i_load);
}

/* The same for any length of the step. */
double supply_advance(supply_t *supply, double h, double i_load);

/* New parameters; the state is kept. */
void supply_change(supply_t *supply, const plant_bus_t *config);

/* New voltage of the source [V]. */
void supply_set(supply_t *supply, double volts);

/* Switch the brake resistor. */
void supply_switch(supply_t *supply, bool braking);

/* Another voltage of the source for some time [V], [s]; end it. */
void supply_dip(supply_t *supply, double volts, double seconds);
void supply_recover(supply_t *supply);

/* Advance the temperature of the brake resistor by `h` seconds. */
void supply_warm(supply_t *supply, double h);

/* Take a charge at once [A s]: correction of a load that was estimated too low. */
static inline void supply_take(supply_t *supply, double charge) { supply->u -= charge * supply->inv_c; }

#endif

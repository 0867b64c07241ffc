/* supply.h - the DC bus: source, capacitor, brake resistor.
 *
 *   C du/dt = i_source - u / R_brake - i_load,   i_source = max(0, (u_source - u) / R)
 * The source is a rectifier: what braking motors return stays in the capacitor. Exact while the load is constant, the
 * moment included in which the source joins in or lets go.
 */
#ifndef PLANT_SUPPLY_H
#define PLANT_SUPPLY_H

#include <stdbool.h>

#include "board.h"
#include "plant/thermal.h"

typedef struct {
    double u_source;  /* open-circuit voltage [V] */
    double u_nominal;   /* the same after a dip */
    double dip;       /* how long that lasts yet; 0: there is none [s] */
    double g_source;  /* [S] */
    double g_brake;   /* of the resistor [S]; 0: there is none */
    double c, inv_c;  /* [F], [1/F] */
    double per_rc;    /* [1/s] */
    bool braking;     /* the resistor is switched on */
    double regular;   /* steps of fewer R C are quick to compute: no brake, no dip; 0: none [R C] */
    double u;         /* [V] */
    double e_source;  /* delivered by the source into the bus so far [J] */
    double e_brake;   /* burnt in the resistor so far [J] */
    double e_warm;    /* the part of it that its temperature has seen [J] */
    thermal_t brake;  /* the resistor */
} supply_t;

/* What follows from the length of a step alone while the source feeds the bus. */
typedef struct {
    double h;          /* [s] */
    double x;          /* h / (R C) */
    double end, mean;  /* (1 - e^-x) / x, (x - 1 + e^-x) / x^2 */
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

/* The bus is charged to the voltage of the source. */
void supply_init(supply_t *supply, const plant_bus_t *config, double ambient);

/* `h` seconds with the current `i_load` drawn, whatever happens to the bus meanwhile: a change of the regime, a brake, a
 * source of little resistance. Returns the integral of the bus voltage [V s]. */
double supply_advance_slowly(supply_t *supply, double h, double i_load);

/* The same; nearly always the source feeds all along. */
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
    return supply_advance_slowly(s, h, i_load);
}

double supply_advance(supply_t *supply, double h, double i_load);

/* Other parameters from now on. */
void supply_change(supply_t *supply, const plant_bus_t *config);

/* Another source from now on. */
void supply_set(supply_t *supply, double volts);

/* The brake resistor is switched on, or off. */
void supply_switch(supply_t *supply, bool braking);

/* Another one for some time. */
void supply_dip(supply_t *supply, double volts, double seconds);
void supply_recover(supply_t *supply);

/* Temperature of the resistor after another `h` seconds. */
void supply_warm(supply_t *supply, double h);

/* Charge taken out at once [A s]: a correction to loads that were given too low. */
static inline void supply_take(supply_t *supply, double charge) { supply->u -= charge * supply->inv_c; }

#endif

/* thermal.h - temperatures of a winding and of a heatsink: one capacity each, one resistance to the ambient air.
 *
 *   C dT/dt = P - (T - T_ambient) / R
 */
#ifndef PLANT_THERMAL_H
#define PLANT_THERMAL_H

typedef struct {
    double capacity;   /* [J/K] */
    double resistance; /* [K/W] */
    double ambient;    /* [deg C] */
    double t;          /* [deg C] */
} thermal_t;

/* Resistance of copper over that at the ambient temperature. */
#define THERMAL_COPPER 3.93e-3 /* [1/K] */

static inline double thermal_copper(const thermal_t *body) { return 1.0 + THERMAL_COPPER * (body->t - body->ambient); }

void thermal_init(thermal_t *body, double capacity, double resistance, double ambient);

/* Another body at the same temperature. */
void thermal_change(thermal_t *body, double capacity, double resistance);

/* Part of its way that a magnet, which follows its winding, has gone after `h` seconds; `time` 0: all of it. */
double thermal_magnet(double h, double time);

/* `energy` has been burnt in the last `h` seconds, evenly [J]. */
void thermal_advance(thermal_t *body, double h, double energy);

#endif

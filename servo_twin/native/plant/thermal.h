/* thermal.h - temperature of a body (winding, heatsink, resistor): one heat capacity, one resistance to the ambient air.
 *
 *   C dT/dt = P - (T - T_ambient) / R
 */
#ifndef PLANT_THERMAL_H
#define PLANT_THERMAL_H

typedef struct {
    double capacity; /* heat capacity [J/K] */
    double resistance; /* thermal, to the ambient air [K/W] */
    double ambient; /* [deg C] */
    double t; /* temperature [deg C] */
} thermal_t;

#define THERMAL_COPPER 3.93e-3 /* temperature coefficient of copper's resistance [1/K] */

/* Resistance of copper relative to that at the ambient temperature. */
static inline double thermal_copper(const thermal_t *body) { return 1.0 + THERMAL_COPPER * (body->t - body->ambient); }

/* At the ambient temperature. */
void thermal_init(thermal_t *body, double capacity, double resistance, double ambient);

/* New parameters; the temperature is kept. */
void thermal_change(thermal_t *body, double capacity, double resistance);

/* Share of the temperature difference between winding and magnet that has decayed after `h` seconds, at the time constant `time`
 * [s]; 1 if that is 0. */
double thermal_magnet(double h, double time);

/* Advance by `h` seconds with the loss `energy` [J], evenly distributed. */
void thermal_advance(thermal_t *body, double h, double energy);

#endif

/* bus.h - the DC bus that both inverters share.
 *
 *   C du/dt = i_source - i_inverters,   i_source = max(0, (u_source - u) / R)
 * The source is a rectifier: what a braking motor returns stays in the capacitor.
 */
#ifndef PLANT_BUS_H
#define PLANT_BUS_H

#include "board.h"

typedef struct {
    double u_source;      /* open-circuit voltage [V] */
    double r_source;      /* [ohm] */
    double step_over_c;   /* [V/A] */
    double approach;      /* 1 - exp(-step / (R C)) */
    double step_over_rc;
    double u_dc;          /* [V] */
} plant_dc_bus_t;

/* The bus is charged to the source voltage. `step` is the fixed step of plant_bus_step [s]. */
void plant_bus_init(plant_dc_bus_t *bus, const plant_bus_t *config, double step);

/* One step with the mean current `i_load` drawn by the inverters [A]; exact while it is constant. */
void plant_bus_step(plant_dc_bus_t *bus, double i_load);

#endif

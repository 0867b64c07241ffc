/* switching_parameters.h - from the configuration to the parts of the switching plant.
 * Internal: only the files switching* include it.
 */
#ifndef PLANT_SWITCHING_PARAMETERS_H
#define PLANT_SWITCHING_PARAMETERS_H

#include "plant/switching.h"

/* External torque [N m]. */
void switching_apply_load(switching_t *plant, int axis, double torque);

/* Sensors, switches, shaft and end stops of an axis; its inverter and motor are switched_inverter_change. */
void switching_apply_axis(switching_t *plant, int axis, const board_config_t *config);

/* Sensor of the bus; the rest is supply_change. */
void switching_apply_bus(switching_t *plant, const plant_bus_t *bus);

/* Flux linkage of the magnet at its present temperature [V s]. */
double switching_magnet_flux(const switching_t *plant, int axis);

#endif

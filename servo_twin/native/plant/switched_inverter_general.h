/* switched_inverter_general.h - general integration of the switched inverter: whatever happens to currents and shaft.
 * Internal: only the files switched_inverter* include it.
 */
#ifndef PLANT_SWITCHED_INVERTER_GENERAL_H
#define PLANT_SWITCHED_INVERTER_GENERAL_H

#include "plant/switched_inverter.h"

/* Begin a segment at the bus voltage u [V]. */
void inverter_general_begin(switched_inverter_t *inv, double u);

/* Advance by h seconds with the mean bus voltage u. Returns the charge drawn from the bus [A s]. */
double inverter_general_advance(switched_inverter_t *inv, double h, double u);

#endif

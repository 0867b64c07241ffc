/* switching_periodic.h - periodic steps of the switching plant: windows of the mean voltages, temperatures, shafts.
 * Internal: only the files switching* include it.
 */
#ifndef PLANT_SWITCHING_PERIODIC_H
#define PLANT_SWITCHING_PERIODIC_H

#include "plant/switching.h"

/* End a window. The plant stops for it at fixed clocks, so that reading the means does not change its motion. */
void switching_end_window(switching_t *plant);

/* Next step of the shafts that need steps of SWITCHING_SHAFT. */
void switching_step_shafts(switching_t *plant);

#endif

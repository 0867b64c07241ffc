/* switching_gates.h - gate edges of the switching plant, and shorts between the rails.
 * Internal: only the files switching* include it.
 */
#ifndef PLANT_SWITCHING_GATES_H
#define PLANT_SWITCHING_GATES_H

#include "plant/switching.h"

/* Trip or release the comparator if the gates feed a short in the motor's cable. */
void switching_check_cable(switching_t *plant, int axis);

#endif

/* analog_out.h - two analogue monitor outputs with selectable variables (DAC of the ST library). */
#ifndef SERVO_APP_ANALOG_OUT_H
#define SERVO_APP_ANALOG_OUT_H

#include "app/latch.h"

/* True if a variable is selected for an output. */
bool analog_out_selected(const board_parameters_t *settings);

/* Output the selected variables, and store them in `shown`: the full scale of a variable is the range of the output,
 * zero is its middle. */
void analog_out_step(const board_parameters_t *settings, const axis_t *axes, hal_t *hal, int16_t *shown);

#endif

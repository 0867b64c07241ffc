/* analog_out.h - two variables, chosen at run time, on two analogue outputs (the DAC of the ST library). */
#ifndef SERVO_APP_ANALOG_OUT_H
#define SERVO_APP_ANALOG_OUT_H

#include "app/latch.h"

/* Does an output show something? */
bool analog_out_wanted(const board_settings_t *settings);

/* Put out what is selected, and note it in `shown`: full scale of the quantity is the range of the output, zero its middle. */
void analog_out_step(const board_settings_t *settings, const axis_t *axes, hal_t *hal, int16_t *shown);

#endif

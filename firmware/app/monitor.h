/* monitor.h - two variables, chosen at run time, on two analogue outputs (the DAC of the ST library). */
#ifndef SERVO_APP_MONITOR_H
#define SERVO_APP_MONITOR_H

#include "app/blocks.h"

struct servo;

/* Does an output show something? */
bool monitor_wanted(const parameter_block_t *parameter);

/* Put out what is selected: full scale of the quantity is the range of the output, zero its middle. */
void monitor_step(struct servo *servo);

#endif

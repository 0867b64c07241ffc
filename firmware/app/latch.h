/* latch.h - takes the command block of the host over as commands of one slow tick.
 *
 * Here "latch" means: everything written since the previous slow tick is taken over together, before the next one. The
 * fault latch and the over-current latch are other things (diagnosis/fault_latch.h, hal/hal.h). */
#ifndef SERVO_APP_LATCH_H
#define SERVO_APP_LATCH_H

#include "app/blocks.h"
#include "drive/axis.h"

#define PARAMETERS_WRITTEN 1U /* by the host: counts like a command */
#define PARAMETERS_RENEWED 2U /* by the board itself */

/* Writes since the last latch. */
typedef struct {
    uint16_t fresh[HAL_AXES]; /* FRESH_ bits */
    uint16_t points; /* number of written timed points */
    bool commands; /* a command was written */
    uint16_t parameters; /* changed: PARAMETERS_ bits */
} latch_marks_t;

void latch_reset(latch_marks_t *marks);

/* Mark the writes in [offset, offset + size) of the command block. */
void latch_mark(latch_marks_t *marks, uint16_t offset, uint16_t size);

/* Apply the writes to the axes and clear the marks. True if a command or a parameter has taken effect. */
bool latch_apply(latch_marks_t *marks, command_block_t *block, const parameter_block_t *parameter, axis_t *axes);

#endif

/* latch.h - from the host's command block to the commands of one slow tick. */
#ifndef SERVO_APP_LATCH_H
#define SERVO_APP_LATCH_H

#include "app/blocks.h"
#include "drive/axis.h"

enum {
    LATCH_POSITION,
    LATCH_SPEED,
    LATCH_I_Q,
    LATCH_MODE,
    LATCH_ENABLE,
    LATCH_QUICK_STOP,
    LATCH_CLEAR_FAULTS,
    LATCH_FIELDS,
};

/* Which elements of the command block were written since the last latch: a bit per axis. */
typedef struct {
    uint16_t axes[LATCH_FIELDS];
    bool any;
} latch_marks_t;

void latch_reset(latch_marks_t *marks);

/* Mark what lies in [offset, offset + size) of the command block. */
void latch_mark(latch_marks_t *marks, uint16_t offset, uint16_t size);

/* Hand the block to the axes and forget the marks. Values outside their limits are clipped and reported. Returns true
 * when something written has taken effect. */
bool latch_apply(latch_marks_t *marks, command_block_t *block, const parameter_block_t *parameter, axis_t *axes);

/* A tick in which the block must not be read: the last commands go on, nothing is fresh. */
void latch_skip(axis_t *axes);

#endif

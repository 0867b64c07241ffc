/* latch.h - from the host's command block to the commands of one slow tick. */
#ifndef SERVO_APP_LATCH_H
#define SERVO_APP_LATCH_H

#include "app/blocks.h"
#include "drive/axis.h"

/* What was written since the last latch. */
typedef struct {
    uint16_t fresh[HAL_AXES]; /* FRESH_ bits */
    uint16_t points;          /* how many timed points */
    bool commands;
    bool parameters;
} latch_marks_t;

/* Parameters that belong to the board as a whole, as they were latched. */
typedef struct {
    uint16_t host_timeout; /* slow ticks */
    uint16_t monitor[HAL_ANALOG_OUTS]; /* monitor_t */
    bool brake_fitted;
} board_settings_t;

void latch_reset(latch_marks_t *marks);

/* Mark what lies in [offset, offset + size) of the command block. */
void latch_mark(latch_marks_t *marks, uint16_t offset, uint16_t size);

/* Hand what was written to the axes and clear the marks. Returns true when a command has taken effect. */
bool latch_apply(latch_marks_t *marks, command_block_t *block, const parameter_block_t *parameter, axis_t *axes);

/* Take over what belongs to no axis. */
void latch_board(const parameter_block_t *parameter, board_settings_t *settings);

#endif

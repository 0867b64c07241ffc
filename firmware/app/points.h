/* points.h - timed points written by the host: one write is queued completely or refused with a reason. */
#ifndef SERVO_APP_POINTS_H
#define SERVO_APP_POINTS_H

#include "app/blocks.h"
#include "drive/axis.h"

/* Input of the check. The server must be locked, so that the queues do not change. */
typedef struct {
    const axis_t *axes;
    const snapshot_t *snapshot;
    bool pending; /* the points of the previous write are not queued yet */
    bool measuring; /* at most POINTS_MEASURING points (points_memory_t) */
} points_board_t;

/* Check points of POINT_WORDS words of four bytes; POINT_REFUSAL_NONE: accepted. Each segment must be within the
 * limits of the axis between its ends, too; the first segment begins at the preceding queued point, otherwise at the
 * present set-point. */
point_refusal_t points_check(const points_board_t *board, const uint8_t *data, uint16_t size);

/* Queue the first `count` points of the block. Returns the axes with new points, one bit each. */
uint16_t points_queue(axis_t *axes, const command_block_t *block, uint16_t count);

#endif

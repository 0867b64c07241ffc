/* points.h - timed points of a trajectory as the host writes them: refused with a reason, or queued as a whole. */
#ifndef SERVO_APP_POINTS_H
#define SERVO_APP_POINTS_H

#include "app/blocks.h"
#include "drive/axis.h"

/* What the points are checked against. To be called while the server is locked: nothing else is put into a queue meanwhile. */
typedef struct {
    const axis_t *axes;
    const snapshot_t *snapshot;
    bool full; /* points that were written before have not been queued yet */
} points_board_t;

/* May the points, POINT_WORDS words of four bytes each, be queued? POINT_REFUSAL_NONE if so. Every segment has to keep the
 * axis's limits between its ends, too; the first one begins where the axis is meant to be now. */
point_refusal_t points_check(const points_board_t *board, const uint8_t *data, uint16_t size);

/* Queue the first `count` points of the block; a bit per axis that has got one. */
uint16_t points_queue(axis_t *axes, const command_block_t *block, uint16_t count);

#endif

/* ranges.h - range check of writes by the host: every element must be within the range of its variable. */
#ifndef SERVO_APP_RANGES_H
#define SERVO_APP_RANGES_H

#include <stdbool.h>
#include <stdint.h>

#include "app/blocks.h"
#include "app/variables.h"
#include "drive/axis_data.h"

/* Memory that the host writes to. */
typedef struct {
    const uint8_t *memory;
    uint16_t positions; /* offset of the position set-points in `memory`, bytes */
    uint16_t features; /* offset of the features in `memory`, bytes */
    uint16_t feedbacks; /* offset of the sources of angle and speed in `memory`, bytes */
    const snapshot_t *snapshot;
    const axis_t *axes;
} ranges_memory_t;

/* Check a write of `size` bytes at `offset`, of the bits set in `mask` (NULL: all). Position set-points must also be
 * within POSITION_REACH of the shaft, and the configuration must have the constants of a feature or a feedback. The
 * server must be locked. */
bool ranges_accept(const ranges_memory_t *in, uint16_t offset, const uint8_t *data, const uint8_t *mask, uint16_t size);

#endif

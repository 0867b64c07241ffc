/* ranges.h - which writes of the host the application takes: no element may leave the range of its variable. */
#ifndef SERVO_APP_RANGES_H
#define SERVO_APP_RANGES_H

#include <stdbool.h>
#include <stdint.h>

#include "app/blocks.h"
#include "app/variables.h"

/* The memory that the host writes to. */
typedef struct {
    const uint8_t *memory;
    uint16_t positions; /* offset of the position set-points */
    const snapshot_t *snapshot;
} ranges_memory_t;

/* May `size` bytes at `offset` become `data` where `mask` (NULL: everywhere) has ones? Position set-points have to be
 * within POSITION_REACH of the shaft as well. To be called while the server is locked. */
bool ranges_accept(const ranges_memory_t *in, uint16_t offset, const uint8_t *data, const uint8_t *mask, uint16_t size);

/* An element of a variable as a number of its bits, and whether it may have a value. */
uint32_t ranges_get(const variable_range_t *range, const uint8_t *element);
void ranges_set(const variable_range_t *range, uint8_t *element, uint32_t value);
bool ranges_accept_value(const variable_range_t *range, uint32_t value);

#endif

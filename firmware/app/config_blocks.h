/* config_blocks.h - change of the configuration of an axis at run time.
 *
 * Each axis has two blocks: the block in force, and a spare block written by the host. config.window writes members to
 * the spare block, with a range check; the checksum, written after the last member, marks the block as ready;
 * config.take exchanges the blocks of one or both axes between two slow ticks, or refuses all. Members that are not
 * `live` change only at rest with the outputs off.
 */
#ifndef SERVO_APP_CONFIG_BLOCKS_H
#define SERVO_APP_CONFIG_BLOCKS_H

#include "app/blocks.h"
#include "config/axis_config.h"
#include "drive/axis_data.h"

typedef struct {
    axis_config_t block[HAL_AXES][2];
    uint16_t in_force[HAL_AXES]; /* index of the block in force: 0, 1 */
    bool ready[HAL_AXES];        /* the spare block is complete, its checksum is correct */
    uint32_t checksum[HAL_AXES]; /* checksum of the spare block */
    uint16_t rest_member[HAL_AXES]; /* first changed member that may change only at rest; AXIS_MEMBERS: none */
    uint16_t reserved; /* axes whose spare block the host must not write, one bit each */
    uint16_t pending; /* axes whose spare block is to be activated, one bit each */
} config_blocks_t;

/* Initialise the blocks in force with the values of `config`. Stored values may replace them until config_blocks_begin. */
void config_blocks_init(config_blocks_t *blocks, config_status_t *status, const servo_config_t *config);

/* Block in force, to be written before config_blocks_begin only. */
static inline axis_config_t *config_blocks_writable(config_blocks_t *blocks, uint16_t axis)
{
    return &blocks->block[axis][blocks->in_force[axis]];
}

/* Initialise checksums and spare blocks from the blocks in force. */
void config_blocks_begin(config_blocks_t *blocks, config_status_t *status);

/* Block in force. */
static inline const axis_config_t *config_blocks_in_force(const config_blocks_t *blocks, uint16_t axis)
{
    return &blocks->block[axis][blocks->in_force[axis]];
}

/* Check a write to config.* at `offset` of config_request_t. Members are stored in the spare block immediately.
 * `whole`: the write has no mask. */
bool config_blocks_accept(config_blocks_t *blocks, config_status_t *status, uint16_t offset, bool whole,
                          const uint8_t *data, uint16_t size);

/* After an accepted write of config.window: a request without members reads the members in force. */
void config_blocks_show(const config_blocks_t *blocks, config_request_t *request);

/* Keep the block in force of an axis: a copy in the spare block of the next axis, whose configuration is reserved until
 * config_blocks_release. False while blocks are pending. */
bool config_blocks_keep(config_blocks_t *blocks, uint16_t axis);

/* Reserve the configuration of all axes. */
void config_blocks_reserve(config_blocks_t *blocks);

/* Stage the kept block with its checksum, to be activated at rest with the outputs off; not while blocks are pending. */
void config_blocks_return(config_blocks_t *blocks, uint16_t axis, uint32_t sum);

/* The host may write all blocks again. */
void config_blocks_release(config_blocks_t *blocks);

/* Between two slow ticks: activate the pending blocks, if the changed members are `live` or the axes are at rest.
 * True if activated; parameters with a changed default are set to the new default. */
bool config_blocks_latch(config_blocks_t *blocks, config_status_t *status, parameter_block_t *parameter,
                         nominal_block_t *nominal, axis_t *axes);

#endif

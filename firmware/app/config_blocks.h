/* config_blocks.h - configuration blocks: another one for an axis while the board runs.
 *
 * Each axis has two blocks: the one in force, and a spare that the host writes. config.window carries members into the
 * spare, each checked against its range; config.header brings layout, length and checksum of the whole, which makes the
 * spare ready; config.take exchanges the blocks of one axis or of both, between two slow ticks, or of none. Members that
 * are not `live` change at rest with the outputs off only.
 */
#ifndef SERVO_APP_CONFIG_BLOCKS_H
#define SERVO_APP_CONFIG_BLOCKS_H

#include "app/blocks.h"
#include "config/axis_config.h"
#include "drive/axis_data.h"

typedef struct {
    axis_config_t block[HAL_AXES][2];
    uint16_t in_force[HAL_AXES]; /* which of the two */
    bool ready[HAL_AXES];        /* the spare has the right checksum .. */
    uint32_t checksum[HAL_AXES]; /* .. and this is it */
    uint16_t
        rest_member[HAL_AXES]; /* first one that differs and may not change in motion; AXIS_MEMBERS: there is none */
    uint16_t pending;            /* axes whose spare is to be taken, a bit each */
} config_blocks_t;

/* The blocks in force are the built-in ones. Others may take their place (config_blocks_restore) until config_blocks_begin. */
void config_blocks_init(config_blocks_t *blocks, config_status_t *status);

/* The block in force, to be written before config_blocks_begin. */
static inline axis_config_t *config_blocks_restore(config_blocks_t *blocks, uint16_t axis)
{
    return &blocks->block[axis][blocks->in_force[axis]];
}

/* The blocks in force stay: the spare ones are the same, and all of them have their sums. */
void config_blocks_begin(config_blocks_t *blocks, config_status_t *status);

static inline const axis_config_t *config_blocks_block(const config_blocks_t *blocks, uint16_t axis)
{
    return &blocks->block[axis][blocks->in_force[axis]];
}

/* Is this write of a part of `request`, whose value it is to become, acceptable? Members go to their block at once.
 * `whole` says that no mask leaves anything out. */
bool config_blocks_accept(config_blocks_t *blocks, config_status_t *status, uint16_t offset, bool whole,
                          const uint8_t *data, uint16_t size);

/* An accepted write of config.window has become the value of `request`: without members it asks for those in force. */
void config_blocks_show(const config_blocks_t *blocks, config_request_t *request);

/* Between two slow ticks: take what is pending, if the axes are at rest or need not be. True if blocks have been taken;
 * parameters whose default is another one then have the new default. */
bool config_blocks_latch(config_blocks_t *blocks, config_status_t *status, parameter_block_t *parameter,
                         nominal_block_t *nominal, axis_t *axes);

#endif

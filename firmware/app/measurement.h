/* measurement.h - session of a host that changes configuration and parameters of an axis for a measurement.
 *
 * Between the beginning (measurement.axis = number of the axis) and the end of a session the host may take other
 * configuration blocks of this axis and write any parameter. At the end the board restores the values of the beginning
 * itself: when the host ends the session (0), after param.host_timeout without a command or keep-alive, with the
 * application command QUICK_STOP, or when another session is begun.
 *
 * The block of the beginning is kept in the spare block of the next axis (config_blocks_keep), so it needs no memory.
 * Runs in the background loop.
 */
#ifndef SERVO_APP_MEASUREMENT_H
#define SERVO_APP_MEASUREMENT_H

#include "app/blocks.h"
#include "config/contract_gen.h"

struct servo;

typedef struct {
    parameter_block_t parameter; /* values at the beginning */
    uint32_t checksum; /* checksum of the configuration block at the beginning */
    frac32_t speed; /* cmd.speed at the beginning, Q1.31 of full-scale speed */
    frac16_t i_q; /* cmd.i_q at the beginning, Q1.15 of full-scale current */
    uint16_t mode; /* cmd.mode at the beginning, control_mode_t */
    uint16_t axis; /* index of the axis */
    bool enabled; /* the axis was enabled at the beginning */
    bool stops; /* the axis is disabled before the values are restored */
} measurement_t;

/* Initialise without a session. */
void measurement_init(struct servo *servo);

/* Check a write to measurement.*, at `offset` of measurement_request_t. `whole`: the write has no mask. */
bool measurement_accept(struct servo *servo, uint16_t offset, bool whole, const uint8_t *data, uint16_t size);

/* End an open session, and restore the values of its beginning from now on. The server must be locked. */
void measurement_end(struct servo *servo, measurement_end_t reason);

/* True if a write to servo_t would enable the axis while its values are being restored. */
bool measurement_refuses(const struct servo *servo, uint16_t offset, const uint8_t *data, uint16_t size);

/* End a session whose host is silent; continue a restoration. */
void measurement_step(struct servo *servo);

#endif

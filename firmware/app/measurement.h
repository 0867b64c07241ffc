/* measurement.h - session of a host that changes configuration and parameters of an axis for a measurement.
 *
 * Between the beginning (measurement.axis = number of the axis) and the end of a session the host may take other
 * configuration blocks of this axis and write any parameter. At the end the board restores the values of the beginning
 * itself: when the host ends the session (0), after param.host_timeout without a command or keep-alive, with the
 * application command QUICK_STOP, or when another session is begun.
 *
 * It needs no memory: the block of the beginning is kept in the spare block of the next axis (config_blocks_keep), the
 * parameters in the memory of the timed points, of which at most POINTS_MEASURING are written together meanwhile.
 * Runs in the background loop.
 */
#ifndef SERVO_APP_MEASUREMENT_H
#define SERVO_APP_MEASUREMENT_H

#include "app/servo.h"
#include "config/contract_gen.h"

/* Check a write to measurement.*, at `offset` of measurement_request_t. `whole`: the write has no mask. */
bool measurement_accept(servo_t *servo, uint16_t offset, bool whole, const uint8_t *data, uint16_t size);

/* End an open session, and restore the values of its beginning from now on. The server must be locked. */
void measurement_end(servo_t *servo, measurement_end_t reason);

/* True if a write to servo_t would enable the axis while its values are being restored. */
bool measurement_refuses(const servo_t *servo, uint16_t offset, const uint8_t *data, uint16_t size);

/* End a session whose host is silent; continue a restoration. */
void measurement_step(servo_t *servo);

#endif

/* replay_hal.h - a board that returns recorded inputs and stores the outputs. */
#ifndef TARGETS_REPLAY_HAL_H
#define TARGETS_REPLAY_HAL_H

#include "app/servo.h"
#include "exchange.h"
#include "trace.h"

struct hal {
    const uint16_t *in; /* words of this call that have not been read */
    uint16_t remaining;
    uint16_t missing; /* reads beyond the recorded words, which return 0 */
    out_log_t out;
    uint32_t flash[STORAGE_COPIES][STORED_WORDS]; /* words after a set stay erased */
};

/* An erased data flash. */
void replay_power_on(hal_t *hal);

/* Pass the words of a recorded call to the board. */
void replay_load(hal_t *hal, const trace_call_t *call);

/* Call the entry point; false for a call that does not exist. */
bool replay_call(servo_t *servo, hal_t *hal, const trace_call_t *call);

#endif

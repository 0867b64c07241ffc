/* state_machine.h - the main state machine of one axis (DRM 4.4, F36).
 *
 * FAULT -> INIT -> STOP <-> RUN, controlled by flags; each transition has a function, called before the state changes.
 * One implementation for all axes.
 */
#ifndef SERVO_DRIVE_STATE_MACHINE_H
#define SERVO_DRIVE_STATE_MACHINE_H

#include <stdint.h>

#include "config/contract_gen.h"

struct axis;

/* Calling loop: each sub-state has one function per loop. */
typedef enum {
    LOOP_FAST,
    LOOP_SLOW,
    LOOP_OBSERVED, /* fast loop with observer */
    LOOP_ESTIMATE, /* axis_estimate */
    LOOP_CHECK, /* axis_check */
    LOOP_TEST_SIGNAL, /* fast loop with a test signal on a current */
} axis_loop_t;

typedef void (*axis_function_t)(struct axis *axis);
typedef void (*state_function_t)(struct axis *axis, axis_loop_t loop);

/* Control flags (DRM 4.4). */
#define SM_CTRL_NONE UINT16_C(0x00)
#define SM_CTRL_FAULT UINT16_C(0x01)
#define SM_CTRL_FAULT_CLEAR UINT16_C(0x02)
#define SM_CTRL_INIT_DONE UINT16_C(0x04)
#define SM_CTRL_STOP UINT16_C(0x08)
#define SM_CTRL_START UINT16_C(0x10)
#define SM_CTRL_STOP_ACK UINT16_C(0x20)
#define SM_CTRL_RUN_ACK UINT16_C(0x40)

typedef struct {
    state_function_t fault;
    state_function_t init;
    state_function_t stop;
    state_function_t run;
} sm_states_t;

typedef struct {
    axis_function_t fault_init;
    axis_function_t init_fault;
    axis_function_t init_stop;
    axis_function_t stop_fault;
    axis_function_t stop_init; /* exists in the reference design; no flag causes it */
    axis_function_t stop_run;
    axis_function_t run_fault;
    axis_function_t run_stop;
} sm_transitions_t;

typedef struct {
    const sm_states_t *states;
    const sm_transitions_t *transitions;
    uint16_t ctrl; /* control flags */
    state_t state;
    uint16_t entered; /* remaining slow ticks, of EVENT_TICKS, since state or sub-state changed */
} sm_t;

/* Time for which an event stays visible to a recorder that does not sample in every period. */
#define EVENT_TICKS 64 /* slow ticks */

/* Call the function of the present state for `loop`, then at most one transition. */
void sm_step(sm_t *sm, struct axis *axis, axis_loop_t loop);

#endif

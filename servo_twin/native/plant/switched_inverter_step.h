/* switched_inverter_step.h - one step of the general integration, and the event that ends it early.
 * Internal: only the files switched_inverter* include it.
 */
#ifndef PLANT_SWITCHED_INVERTER_STEP_H
#define PLANT_SWITCHED_INVERTER_STEP_H

#include "plant/switched_inverter_legs.h"

/* Why a step ends. */
typedef enum {
    STEP_COMPLETE,
    STEP_CURRENT_ZERO, /* the current of `phase` reaches zero */
    STEP_LEG_LIMIT, /* a floating leg has reached a limit of its voltage: a current of this sign begins in `phase` */
    STEP_SHAFT_STOPPED,
    STEP_SHAFT_STARTED,
    STEP_END_STOP, /* the shaft reaches an end stop; sign 1: the upper one */
} step_reason_t;

typedef struct {
    double duration; /* [s] */
    step_reason_t reason;
    int phase; /* -1: two legs begin to conduct */
    int sign;
} step_limit_t;

/* Step of h seconds, without a search for events. Sets *floating_volts to the floating leg's voltage at the end, if any [V]. */
void inverter_general_step(const switched_inverter_t *inv, double h, double u, step_end_t *e, double *floating_volts);

/* Step of at most h seconds, which ends at the first event. */
step_limit_t inverter_general_step_to_event(const switched_inverter_t *inv, double h, double u, step_end_t *e);

#endif

/* stop.h - how an axis comes to rest when its drive is withdrawn: by a command, or by a fault that leaves a choice.
 *
 * A category that the moment does not permit gives way to the next harsher one: hold -> ramp -> short -> coast. What is
 * demanded while a stop is in progress takes over if it is harsher.
 */
#ifndef SERVO_DRIVE_STOP_H
#define SERVO_DRIVE_STOP_H

#include "config/contract_gen.h"
#include "drive/faults.h"
#include "math/frac.h"

struct axis;

typedef struct {
    uint16_t disable;         /* default of the writable stop_category_t; hold: for hold_ticks */
    uint16_t quick_stop;      /* default of the writable stop_category_t; hold: as long as the drive is wanted */
    fault_set_t shorted, ramp, hold; /* faults that are answered so; all others coast */
    /* Up to it the steady current of the short, K_e w / sqrt(R_s^2 + w^2 L_s^2), is allowed (ST slide "Winding
     * short"). */
    frac32_t short_speed;
    frac16_t short_current; /* and no more than this may flow */
    uint16_t ticks_most; /* slow ticks from the beginning of a stop until the outputs go off in any case */
    uint16_t hold_ticks; /* slow ticks that an axis without a drive holds its position */
} stop_config_t;

typedef struct {
    stop_category_t category; /* of the stop in progress, while the drive is not wanted */
    uint16_t ticks; /* slow ticks since it began */
    uint16_t held; /* slow ticks at rest */
} stop_t;

/* Withdraw the drive, or let a stop in progress go on in a harsher way. */
void stop_begin(struct axis *axis, stop_category_t category);

/* The harshest answer to a set of faults. */
stop_category_t stop_for(const stop_config_t *config, fault_set_t faults);

/* True while an axis can still be brought to rest by what drives it. */
bool stop_in_hand(const struct axis *axis);

/* True if the windings may be shorted at this speed. */
bool stop_may_short(const struct axis *axis);

/* One slow tick of a spinning axis without a drive: how it goes on. STOP_CATEGORY_COAST: outputs off now; STOP_CATEGORY_SHORT: short the
 * windings now; else go on decelerating or holding. */
stop_category_t stop_step(struct axis *axis);

/* One slow tick of shorted windings: true when the short has to end. */
bool stop_short_over(struct axis *axis);

/* True if more current flows in the short than is allowed. */
bool stop_short_overloaded(const struct axis *axis);

#endif

/* angle_watch.h - does the back-EMF lie where the encoder says?
 *
 * What the current controllers ask of the inverter is the voltage of the windings, with the back-EMF where the encoder has
 * it. More than that is a back-EMF that points elsewhere: the encoder has slipped. It shows in motion, as soon as the
 * back-EMF is larger than what resistance and dead time may be off by, and at no cost to the fast loop. The observer of
 * FEATURE_ANGLE_CHECK sees it sooner, and with less current.
 */
#ifndef SERVO_DRIVE_ANGLE_WATCH_H
#define SERVO_DRIVE_ANGLE_WATCH_H

#include "control/transforms.h"
#include "drive/faults.h"

typedef struct {
    dq_t current;   /* of the last tick */
    dq_t beyond;    /* voltage that nothing explains, filtered */
    uint16_t ticks; /* slow ticks of too much of it, less those without */
} angle_watch_t;

struct axis;

/* One slow tick of current control with the encoder's angle. */
fault_set_t angle_watch_step(struct axis *axis);

/* `fault`, or ANGLE_MISMATCH where the back-EMF is missed by more than its size: a resistance whose drop is larger had kept
 * the watch in doubt. A resistance that is off by as much looks the same. */
fault_set_t angle_watch_rather(const struct axis *axis, fault_set_t fault);

#endif

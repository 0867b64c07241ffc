/* supervision.h - what a spinning shaft must not do: stall, run away, leave its set-point, turn too fast. */
#ifndef SERVO_DRIVE_SUPERVISION_H
#define SERVO_DRIVE_SUPERVISION_H

#include "drive/faults.h"
#include "math/frac.h"

struct axis;

typedef struct {
    uint16_t stall_ticks;      /* slow ticks at full current without movement */
    uint16_t runaway_ticks;    /* slow ticks of gaining speed that should be lost */
    uint32_t braked_speed;     /* least speed since it should have been falling, 31 fraction bits */
    uint16_t following_ticks;  /* slow ticks too far from the set-point */
    uint16_t over_speed_ticks; /* slow ticks of turning too fast */
} supervision_t;

void supervision_start(supervision_t *supervision);

/* One slow tick, after the controllers; returns the faults (FAULT_ bits) that have lasted long enough. */
fault_set_t supervision_step(struct axis *axis);

#endif

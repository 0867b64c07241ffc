/* estimate.h - observer and PLL of an axis, whatever they are used for: its feedback, or the check of its encoder. */
#ifndef SERVO_DRIVE_ESTIMATE_H
#define SERVO_DRIVE_ESTIMATE_H

#include "control/pll.h"
#include "sensing/emf_check.h"
#include "sensing/speed_reliability.h"

struct axis;

typedef struct {
    observer_t observer;
    pll_t pll;
    speed_reliability_t reliability;
    emf_check_t check;
    ab_t emf;         /* in the last slow tick, stator frame */
    frac16_t size;    /* its length */
    dq_t deviation;   /* what of it neither angle nor speed explains */
    frac32_t speed;   /* mechanical */
    uint32_t angle;   /* of the last slow tick, 2^32 is a turn */
    int32_t turned;   /* angle between the last two */
    bool astern;      /* the shaft turned backwards when the closed loop began */
    uint16_t standing; /* slow ticks in which it hardly turned that way */
    bool deviates;    /* the back-EMF, over some time, fits neither angle nor speed */
    bool locked;      /* the PLL follows the back-EMF; otherwise it goes on as it was set */
    bool runs;
} estimate_t;

/* From rest, with the rotor believed at `angle`, turning by `step` per period. */
void estimate_start(struct axis *axis, uint32_t angle, int32_t step);
void estimate_stop(struct axis *axis);

/* The PLL goes on from an angle known from elsewhere. */
void estimate_set(struct axis *axis, uint32_t angle, int32_t step);

/* One slow tick. */
void estimate_step(struct axis *axis);

/* Back-EMF, as in the last slow tick, that belongs to a speed. */
frac16_t estimate_emf_at(const struct axis *axis, frac32_t speed);

/* Slow ticks in a row in which the shaft has been too slow to be observed, or has turned the other way, which it cannot
 * without standing in between: a model of it would go on for ever, with one that swings where it is held, too. */
uint16_t estimate_standing(struct axis *axis);

/* Angle and speed can be believed. */
bool estimate_reliable(const struct axis *axis);

#endif

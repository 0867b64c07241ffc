/* field_weakening.h - i_d against the flux of the magnets, so that the voltage suffices at higher speeds.
 *
 * An integral controller keeps the stator voltage a margin below its limit. What it controls with is one chain of two
 * actuators: first i_d, down to -i_d_max; when that is used up, the motoring i_q gives way, down to 0. On the way back i_q
 * comes first. Each step moves one of the two, so they never work against each other.
 *
 * The error is the difference of the squared voltages, which is 2 u_max (u_max - |u|) to first order and needs no root. The
 * voltage is the demand of the current controllers before their limit: the limited one would never be more than the margin
 * too long, whatever is missing.
 */
#ifndef SERVO_CONTROL_FIELD_WEAKENING_H
#define SERVO_CONTROL_FIELD_WEAKENING_H

#include "control/transforms.h"

#define FIELD_WEAKENING_GAIN_BITS 8

typedef struct {
    frac16_t margin;  /* voltage that stays free below the limit, for what the current controllers need in motion */
    frac16_t gain;    /* squared voltage -> change of the current per step, FIELD_WEAKENING_GAIN_BITS fraction bits */
    frac16_t i_d_max; /* what current limit and magnets allow */
    frac16_t q_share; /* change of i_q over that of i_d for the same change of the voltage */
} field_weakening_config_t;

/* All zero: no effect. */
typedef struct {
    frac32_t d; /* -i_d* */
    frac32_t q; /* taken from the motoring i_q, only while d is at its end */
    frac16_t i_q_max; /* what i_d leaves of the current circle */
} field_weakening_t;

typedef struct {
    dq_t demand;      /* voltage that the current controllers ask for, not limited */
    frac16_t u_max;   /* their limit */
    frac16_t emf;     /* back-EMF at i_d = 0 */
    frac16_t current; /* longest current vector */
    bool enabled;      /* else what there is is given back as far as the voltage allows */
} field_weakening_input_t;

/* Once per slow tick. i_d changes by an eighth of its range at most. */
void field_weakening_step(field_weakening_t *state, const field_weakening_config_t *config,
                          const field_weakening_input_t *input);

/* The current has to stay within i_q_max and field_weakening_motoring. */
static inline bool field_weakening_active(const field_weakening_t *state) { return state->d != 0; }

/* i_d*, not above 0. */
static inline frac16_t field_weakening_i_d(const field_weakening_t *state) { return (frac16_t)-asr32(state->d, 16); }

/* Largest i_q that drives the shaft. */
static inline frac16_t field_weakening_motoring(const field_weakening_t *state)
{
    return f16_sub(state->i_q_max, (frac16_t)asr32(state->q, 16));
}

#endif

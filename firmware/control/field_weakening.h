/* field_weakening.h - field weakening: negative i_d at speeds at which the back-EMF exceeds the voltage limit
 * (doc/field-weakening.md).
 *
 * Voltage feedback: an integral controller keeps the stator voltage one margin below its limit. Two actuators in
 * sequence: i_d down to -i_d_max, then the motoring i_q down to 0; in the other direction i_q first. Each step changes
 * one of the two.
 *
 *   -i_d(k+1) = limit(-i_d(k) + change, 0, min(i_d_max, 7/8 i_max)),  u_target = u_max - margin
 *   change    = limit(K (u_d^2 + u_q^2 - u_target^2), -i_d_max/8, i_d_max/8); -i_d_max/8 for 2 |e| <= u_target
 *               (e: back-EMF)
 *   i_q       <= sqrt(i_max^2 - i_d^2)                              while field weakening is active
 *
 * Error: difference of the squared voltages, to first order 2 u_target (|u| - u_target); no square root is needed. The
 * measured voltage is the output of the current controllers before their limit, because the limited voltage exceeds the
 * target by at most the margin.
 */
#ifndef SERVO_CONTROL_FIELD_WEAKENING_H
#define SERVO_CONTROL_FIELD_WEAKENING_H

#include "control/transforms.h"

#define FIELD_WEAKENING_GAIN_BITS 8

typedef struct {
    frac16_t margin;  /* voltage reserve of the current controllers below the limit, Q1.15 of full-scale voltage */
    frac16_t gain; /* current per step / squared voltage, FIELD_WEAKENING_GAIN_BITS fraction bits */
    frac16_t i_d_max; /* largest -i_d that current limit and magnets permit, Q1.15 of full-scale current */
    frac16_t q_share; /* change of i_q / change of i_d, for an equal change of the voltage */
} field_weakening_config_t;

/* State of the controller; all zero: no effect. */
typedef struct {
    frac32_t d; /* -i_d*, Q1.31 of full-scale current */
    frac32_t q; /* reduction of the motoring i_q, only while d is at its maximum, Q1.31 of full-scale current */
    frac16_t i_q_max; /* largest i_q on the current circle with the present i_d, Q1.15 of full-scale current */
} field_weakening_t;

typedef struct {
    dq_t demand; /* output of the current controllers before their limit, Q1.15 of full-scale voltage */
    frac16_t u_max; /* voltage limit of the current controllers, Q1.15 of full-scale voltage */
    frac16_t emf; /* back-EMF at i_d = 0, Q1.15 of full-scale voltage */
    frac16_t current; /* largest current vector, Q1.15 of full-scale current */
    bool enabled; /* false: the weakening current is reduced to 0, at the slew rate that the voltage permits */
} field_weakening_input_t;

/* One slow tick. i_d changes by at most an eighth of its range. */
void field_weakening_step(field_weakening_t *state, const field_weakening_config_t *config,
                          const field_weakening_input_t *input);

/* True while i_d is negative: limit i_q to i_q_max and field_weakening_motoring. */
static inline bool field_weakening_active(const field_weakening_t *state) { return state->d != 0; }

/* i_d*, zero or negative. */
static inline frac16_t field_weakening_i_d(const field_weakening_t *state) { return (frac16_t)-asr32(state->d, 16); }

/* Largest motoring i_q. */
static inline frac16_t field_weakening_motoring(const field_weakening_t *state)
{
    return f16_sub(state->i_q_max, (frac16_t)asr32(state->q, 16));
}

#endif

/* emf_check.h - compares the observed back-EMF with (0, omega psi_m) in the frame of a given angle.
 *
 * An angle error rotates the back-EMF, a speed error changes its amplitude. Detects: wrong encoder offset, dead
 * encoder, and an oscillating rotor whose observed speed looks valid (not detected by the variance criterion of the ST
 * document).
 */
#ifndef SERVO_SENSING_EMF_CHECK_H
#define SERVO_SENSING_EMF_CHECK_H

#include "control/transforms.h"

typedef struct {
    frac16_t floor;      /* tolerance for dead time and switches at any speed, Q1.15 of full-scale voltage */
    frac16_t floor_spin; /* `floor` for the filtered deviation, Q1.15 of full-scale voltage */
    gain_t resistance;   /* tolerated error of the resistance: voltage / current, of full scales */
    uint16_t part;       /* tolerated deviation / expected back-EMF, 15 fraction bits */
    uint16_t ticks_spin; /* permitted slow ticks of filtered deviation of a sensorless axis */
    uint16_t ticks_stand; /* permitted slow ticks of a sensorless axis below half of the minimum observable speed */
    uint16_t ticks_check; /* permitted slow ticks of deviation in the check of an encoder */
} emf_check_config_t;

typedef struct {
    int32_t d; /* filtered deviation, 15 + 8 fraction bits of full-scale voltage */
    int32_t q; /* filtered deviation, 15 + 8 fraction bits of full-scale voltage */
    uint16_t ticks; /* slow ticks of deviation, minus slow ticks without */
} emf_check_t;

void emf_check_reset(emf_check_t *check);

/* `emf` - (0, expected), in the frame of the angle to be checked. */
static inline dq_t emf_check_deviation(dq_t emf, frac16_t expected) { return (dq_t){emf.d, f16_sub(emf.q, expected)}; }

/* True if the deviation exceeds the sum of the tolerances: `floor`, the part of the expected back-EMF, and the
 * resistance error at this current. */
bool emf_check_deviates(const emf_check_config_t *config, frac16_t floor, dq_t deviation, frac16_t expected,
                        frac16_t current);

/* Low-pass filter of the deviation, longer than an oscillation of the rotor: time constant 32 slow ticks. */
dq_t emf_check_filter(emf_check_t *check, dq_t deviation);

/* True if the filtered deviation exceeds the fraction `part` of the expected back-EMF, without the tolerances for
 * current and dead time: the back-EMF may be missing. */
bool emf_check_emf_missing(const emf_check_t *check, const emf_check_config_t *config, frac16_t expected);

/* One slow tick: true after more than `max` slow ticks with deviation, minus slow ticks without. */
bool emf_check_confirmed(emf_check_t *check, bool deviates, uint16_t max);

#endif

/* emf_check.h - does the back-EMF fit the angle and the speed that are given?
 *
 * In the frame of the true rotor it is (0, omega psi_m). An angle that is wrong turns it, a speed that is wrong gives it
 * another length. So it tells a wrong encoder offset and a dead encoder, and a rotor that only swings where the observer
 * reports that it turns: the variance of the observed speed, ST's criterion, does not see that one.
 */
#ifndef SERVO_SENSING_EMF_CHECK_H
#define SERVO_SENSING_EMF_CHECK_H

#include "control/transforms.h"

typedef struct {
    frac16_t floor;      /* what dead time and switches leave unexplained at any speed */
    frac16_t floor_spin; /* the same after the filter */
    gain_t resistance;   /* error of the resistance that is tolerated, full-scale current over full-scale voltage */
    uint16_t part;       /* deviation over the back-EMF that is expected, 15 fraction bits */
    uint16_t ticks_spin; /* slow ticks that the observer of a sensorless axis may deviate, after the filter */
    uint16_t ticks_stand; /* slow ticks that its speed may be below half of what it can observe */
    uint16_t ticks_check; /* slow ticks that an encoder may */
} emf_check_config_t;

typedef struct {
    int32_t d; /* filtered deviation, 8 bits more */
    int32_t q; /* the same */
    uint16_t ticks; /* slow ticks of deviation */
} emf_check_t;

void emf_check_reset(emf_check_t *check);

/* What `emf`, in the frame of an angle, has more than (0, expected). */
static inline dq_t emf_check_deviation(dq_t emf, frac16_t expected) { return (dq_t){emf.d, f16_sub(emf.q, expected)}; }

/* True while a deviation is larger than `floor`, the size of what is expected and the current explain. */
bool emf_check_deviates(const emf_check_config_t *config, frac16_t floor, dq_t deviation, frac16_t expected,
                        frac16_t current);

/* Deviation over some periods of a swing: time constant 32 slow ticks. */
dq_t emf_check_filter(emf_check_t *check, dq_t deviation);

/* True while the filtered deviation is the part of a back-EMF that is expected, or more, whatever else might explain it. */
bool emf_check_lacks(const emf_check_t *check, const emf_check_config_t *config, frac16_t expected);

/* One slow tick: true after `most` ticks of deviation, less those without. */
bool emf_check_lasts(emf_check_t *check, bool deviates, uint16_t max);

#endif

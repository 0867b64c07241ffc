/* current_sense_monitor.h - implausible ADC codes of the current measurements.
 *
 * A measurement has failed if its code differs from the offset at the centre of the high side, where the shunt carries
 * no current, or if its code is constant while those of other phases show noise.
 */
#ifndef SERVO_DIAGNOSIS_CURRENT_SENSE_MONITOR_H
#define SERVO_DIAGNOSIS_CURRENT_SENSE_MONITOR_H

#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

typedef struct {
    uint16_t off_samples;   /* consecutive samples that differ from the offset */
    uint16_t last_code;    /* previous ADC code */
    uint16_t equal_codes;    /* number of repetitions of `last_code` */
    uint16_t samples; /* samples of the present window */
    uint16_t min; /* smallest ADC code of the window */
    uint16_t max; /* largest ADC code of the window */
    bool noisy; /* the last complete window showed noise */
} current_sense_channel_t;

typedef struct {
    current_sense_channel_t channel[OBSERVED_PHASES];
} current_sense_monitor_t;

/* One slow tick in every state, with IDLE_SAMPLES new samples. `switching`: the switches operate; with open switches
 * the current of a turning shaft flows in the diodes, and codes are not compared with their offsets. */
void current_sense_monitor_step(current_sense_monitor_t *monitor, const idle_sample_t *samples, bool switching,
                                evidence_t *evidence);

/* Add suspicions about the current measurements. */
void current_sense_monitor_suspect(const current_sense_monitor_t *monitor, evidence_t *evidence);

#endif

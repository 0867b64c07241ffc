/* current_sense_monitor.h - current converters whose code cannot be true.
 *
 * A converter is broken when it reports a current at the centre of the high side, where its shunt carries nothing, or
 * repeats its code while its neighbours show noise.
 */
#ifndef SERVO_DIAGNOSIS_CURRENT_SENSE_MONITOR_H
#define SERVO_DIAGNOSIS_CURRENT_SENSE_MONITOR_H

#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

typedef struct {
    uint16_t off_samples;   /* samples in a row that are off the offset */
    uint16_t last_code;    /* the code before .. */
    uint16_t equal_codes;    /* .. and how often it has come again */
    uint16_t samples; /* of the present window, with its extremes */
    uint16_t min; /* ADC code, the smallest */
    uint16_t max; /* ADC code, the largest */
    bool noisy; /* in the last whole window */
} current_sense_channel_t;

typedef struct {
    current_sense_channel_t channel[OBSERVED_PHASES];
} current_sense_monitor_t;

/* One slow tick with the IDLE_SAMPLES that have just been taken, in every state. `switching`: the high sides conduct in
 * turn. Open switches leave the current of a turning shaft in the diodes. */
void current_sense_monitor_step(current_sense_monitor_t *monitor, const idle_sample_t *samples, bool switching,
                                evidence_t *evidence);

void current_sense_monitor_suspect(const current_sense_monitor_t *monitor, evidence_t *evidence);

#endif

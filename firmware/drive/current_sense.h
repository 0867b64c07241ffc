/* current_sense.h - three-shunt current reconstruction, offsets, bus voltage (DRM 2.3.2, 4.2, F31, F32). */
#ifndef SERVO_DRIVE_CURRENT_SENSE_H
#define SERVO_DRIVE_CURRENT_SENSE_H

#include "control/transforms.h"
#include "hal/hal.h"

#define SENSE_PHASES 3

/* Samples per phase pair that the offset calibration averages, as a power of two. */
#define SENSE_CALIBRATION_BITS 8

typedef struct {
    uint32_t offset[SENSE_PHASES]; /* code of zero current, 16 fraction bits */
    uint32_t sum[SENSE_PHASES]; /* calibration: sum of the codes */
    uint16_t samples; /* calibration: samples in the sum */
    phase_pair_t pair; /* phase pair of the pending conversions */
    abc_t duty;        /* duties during these conversions, Q1.15 */
    abc_t current;     /* phase currents of this period during current control, Q1.15 of full-scale current */
} current_sense_t;

void current_sense_reset(current_sense_t *sense);

/* Phase pair with the longest low-side conduction in a sector of the SVM. */
extern const uint8_t current_sense_pairs[7];
static inline phase_pair_t current_sense_pair(uint16_t sector)
{
    return hal_pair((phase_pair_t)current_sense_pairs[sector]);
}

#define SENSE_OFFSET_BITS 16

/* (12-bit code - offset) / half the ADC range: Q1.15, rounded to nearest, halves downwards. */
static inline int32_t current_sense_of(uint32_t offset, uint16_t code)
{
    const uint32_t above = ((uint32_t)code << SENSE_OFFSET_BITS) - offset;
    return sat16_asr((int32_t)(above + UINT32_C(0x7FF)), SENSE_OFFSET_BITS - 4);
}

/* Phase currents from the codes of the present pair; the third current is their negative sum. */
static inline abc_t current_sense_read(const current_sense_t *sense, adc_pair_t codes)
{
    abc_t x;
    switch (sense->pair) {
    case PHASE_PAIR_AB:
        x.a = current_sense_of(sense->offset[0], codes.first);
        x.b = current_sense_of(sense->offset[1], codes.second);
        x.c = sat16(-(x.a + x.b));
        break;
    case PHASE_PAIR_BC:
        x.b = current_sense_of(sense->offset[1], codes.first);
        x.c = current_sense_of(sense->offset[2], codes.second);
        x.a = sat16(-(x.b + x.c));
        break;
    default:
        x.c = current_sense_of(sense->offset[2], codes.first);
        x.a = current_sense_of(sense->offset[0], codes.second);
        x.b = sat16(-(x.c + x.a));
        break;
    }
    return x;
}

/* Offset calibration with the outputs off, one sample per PWM period. Selects the next pair in `sense->pair`. True
 * when all offsets are measured. */
bool current_sense_calibrate(current_sense_t *sense, adc_pair_t codes);

/* True when every offset lies within `tolerance` codes of mid-scale. */
bool current_sense_offsets_plausible(const current_sense_t *sense, uint16_t tolerance);

/* Track the offset drift with a sample at the high-side centre. The sample is valid only if the high side conducts long
 * enough: phases with a duty below `duty_min` are skipped. */
void current_sense_track(current_sense_t *sense, adc_pair_t codes, frac16_t duty_min);

#endif

#include "drive/current_sense.h"

#define MID_CODE UINT32_C(2048)
#define OFFSET_BITS 16
#define TRACK_SHIFT 8 /* time constant: 256 slow ticks */

/* Phases (0 a, 1 b, 2 c) of the pairs AB, BC, CA. */
static const uint8_t first_phase[3] = {0, 1, 2};
static const uint8_t second_phase[3] = {1, 2, 0};

void current_sense_reset(current_sense_t *sense)
{
    for (uint16_t phase = 0; phase < SENSE_PHASES; phase++) {
        sense->offset[phase] = MID_CODE << OFFSET_BITS;
        sense->sum[phase] = 0;
    }
    sense->samples = 0;
    sense->pair = PHASE_PAIR_AB;
    sense->duty = (abc_t){0, 0, 0};
}

phase_pair_t current_sense_pair(uint16_t sector)
{
    switch (sector) {
    case 2:
    case 3:
        return PHASE_PAIR_CA; /* b has the longest high side */
    case 4:
    case 5:
        return PHASE_PAIR_AB; /* c */
    default:
        return PHASE_PAIR_BC; /* a */
    }
}

/* A 12-bit code against its offset, over half the ADC range: Q1.15. */
static frac16_t current_of(uint32_t offset, uint16_t code)
{
    const int32_t raw = (int32_t)((uint32_t)code << 4) - (int32_t)((offset + UINT32_C(0x800)) >> (OFFSET_BITS - 4));
    return sat16(raw);
}

abc_t current_sense_read(const current_sense_t *sense, adc_pair_t codes)
{
    const frac16_t first = current_of(sense->offset[first_phase[sense->pair]], codes.first);
    const frac16_t second = current_of(sense->offset[second_phase[sense->pair]], codes.second);
    const frac16_t third = sat16(-((int32_t)first + second));
    switch (sense->pair) {
    case PHASE_PAIR_AB:
        return (abc_t){first, second, third};
    case PHASE_PAIR_BC:
        return (abc_t){third, first, second};
    default:
        return (abc_t){second, third, first};
    }
}

bool current_sense_calibrate(current_sense_t *sense, adc_pair_t codes)
{
    const uint16_t window = UINT16_C(1) << SENSE_CALIBRATION_BITS;
    /* The pair asked for in one call is converted before the next: the first sample of a window is already true. */
    if (sense->samples < window) {
        sense->sum[0] += codes.first;
        sense->sum[1] += codes.second;
    } else {
        sense->sum[2] += codes.first; /* pair CA: c comes first */
    }
    sense->samples++;
    sense->pair = (sense->samples < window) ? PHASE_PAIR_AB : PHASE_PAIR_CA;
    if (sense->samples < 2U * window) {
        return false;
    }
    for (uint16_t phase = 0; phase < SENSE_PHASES; phase++) {
        sense->offset[phase] = sense->sum[phase] << (OFFSET_BITS - SENSE_CALIBRATION_BITS);
    }
    return true;
}

bool current_sense_offsets_plausible(const current_sense_t *sense, uint16_t tolerance)
{
    for (uint16_t phase = 0; phase < SENSE_PHASES; phase++) {
        const int32_t code = (int32_t)(sense->offset[phase] >> OFFSET_BITS);
        if (code > (int32_t)MID_CODE + tolerance || code < (int32_t)MID_CODE - tolerance) {
            return false;
        }
    }
    return true;
}

static void track(uint32_t *offset, uint16_t code)
{
    const int32_t error = (int32_t)((uint32_t)code << OFFSET_BITS) - (int32_t)*offset;
    *offset = (uint32_t)((int32_t)*offset + asr32(error, TRACK_SHIFT));
}

void current_sense_track(current_sense_t *sense, adc_pair_t codes, frac16_t duty_least)
{
    const frac16_t duty[SENSE_PHASES] = {sense->duty.a, sense->duty.b, sense->duty.c};
    const uint16_t first = first_phase[sense->pair];
    const uint16_t second = second_phase[sense->pair];
    if (duty[first] >= duty_least) {
        track(&sense->offset[first], codes.first);
    }
    if (duty[second] >= duty_least) {
        track(&sense->offset[second], codes.second);
    }
}

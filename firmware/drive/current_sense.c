#include "drive/current_sense.h"

#define MID_CODE UINT32_C(2048)
#define FIRST_SHUNT ((uint16_t)hal_pair(PHASE_PAIR_AB)) /* phase a, or b if a has no shunt */
#define TRACK_SHIFT 8 /* time constant: 256 slow ticks */

/* The phase with the longest high-side time is not sensed: a in sectors 6 and 1, b in 2 and 3, c in 4 and 5. */
const uint8_t current_sense_pairs[7] = {
    PHASE_PAIR_BC, PHASE_PAIR_BC, PHASE_PAIR_CA, PHASE_PAIR_CA, PHASE_PAIR_AB, PHASE_PAIR_AB, PHASE_PAIR_BC,
};

void current_sense_reset(current_sense_t *sense)
{
    for (uint16_t phase = 0; phase < SENSE_PHASES; phase++) {
        sense->offset[phase] = MID_CODE << SENSE_OFFSET_BITS;
        sense->sum[phase] = 0;
    }
    sense->samples = 0;
    sense->pair = hal_pair(PHASE_PAIR_AB);
    sense->duty = (abc_t){0, 0, 0};
    sense->current = (abc_t){0, 0, 0};
}

bool current_sense_calibrate(current_sense_t *sense, adc_pair_t codes)
{
    const uint16_t window = UINT16_C(1) << SENSE_CALIBRATION_BITS;
    const uint16_t first = (uint16_t)hal_pair((sense->samples < window) ? PHASE_PAIR_AB : PHASE_PAIR_CA);
    /* A pair that is selected in one call is converted before the next call: the first sample of a window is valid. */
    if (sense->samples < window) {
        sense->sum[first] += codes.first;
        sense->sum[first + 1U] += codes.second;
    } else {
        /* Pair CA: c comes first. With two shunts the pair is BC again, and b is measured anew. */
        sense->sum[first] = ((sense->samples == window) ? 0U : sense->sum[first]) + codes.first;
    }
    sense->samples++;
    sense->pair = hal_pair((sense->samples < window) ? PHASE_PAIR_AB : PHASE_PAIR_CA);
    if (sense->samples < 2U * window) {
        return false;
    }
    for (uint16_t phase = FIRST_SHUNT; phase < SENSE_PHASES; phase++) {
        sense->offset[phase] = sense->sum[phase] << (SENSE_OFFSET_BITS - SENSE_CALIBRATION_BITS);
    }
    return true;
}

bool current_sense_offsets_plausible(const current_sense_t *sense, uint16_t tolerance)
{
    for (uint16_t phase = FIRST_SHUNT; phase < SENSE_PHASES; phase++) {
        const int32_t code = (int32_t)(sense->offset[phase] >> SENSE_OFFSET_BITS);
        if (code > (int32_t)MID_CODE + tolerance || code < (int32_t)MID_CODE - tolerance) {
            return false;
        }
    }
    return true;
}

/* The shunt carries no current only while the high side is on for long enough. */
static void track(uint32_t *offset, uint16_t code, bool true_sample)
{
    if (true_sample) {
        const int32_t error = (int32_t)((uint32_t)code << SENSE_OFFSET_BITS) - (int32_t)*offset;
        *offset = (uint32_t)((int32_t)*offset + asr32(error, TRACK_SHIFT));
    }
}

void current_sense_track(current_sense_t *sense, adc_pair_t codes, frac16_t duty_min)
{
    const bool a = sense->duty.a >= duty_min;
    const bool b = sense->duty.b >= duty_min;
    const bool c = sense->duty.c >= duty_min;
    switch (sense->pair) {
    case PHASE_PAIR_AB:
        track(&sense->offset[0], codes.first, a);
        track(&sense->offset[1], codes.second, b);
        break;
    case PHASE_PAIR_BC:
        track(&sense->offset[1], codes.first, b);
        track(&sense->offset[2], codes.second, c);
        break;
    default:
        track(&sense->offset[2], codes.first, c);
        track(&sense->offset[0], codes.second, a);
        break;
    }
}

#include "diagnosis/current_sense_monitor.h"

#define WINDOW 64U         /* samples of a code */
#define NOISE_MIN 4U       /* codes between the extremes of a window: a smaller spread may be chance */
#define SAME_BY_CHANCE 16U /* equal codes in a row that a noisy converter may produce */
#define SAME_SUSPECT 6U    /* equal codes in a row: probability 1 in 10000 with noise of two codes */
#define SAME_REPEATING 2U
#define WRONG_MIN 32U /* codes off the offset: 16 times the usual noise */
#define WRONG_TICKS 4U

/* Determine from the extremes of a window of codes whether the converter shows noise. */
static void note_spread(current_sense_channel_t *c, uint16_t code)
{
    if (c->samples == 0U) {
        c->min = code;
        c->max = code;
    } else if (code < c->min) {
        c->min = code;
    } else if (code > c->max) {
        c->max = code;
    }
    c->samples++;
    if (c->samples >= WINDOW) {
        c->noisy = (uint16_t)(c->max - c->min) >= NOISE_MIN;
        c->samples = 0;
    }
}

/* `same_min` equal codes in a row while another converter shows noise. */
static bool frozen(const current_sense_monitor_t *m, const current_sense_channel_t *c, uint16_t same_min)
{
    if (c->equal_codes < same_min) {
        return false; /* the usual case */
    }
    bool others_noisy = false;
    for (uint16_t y = 0; y < OBSERVED_PHASES; y++) {
        const current_sense_channel_t *other = &m->channel[y];
        others_noisy = others_noisy || (other != c && other->noisy && other->equal_codes < SAME_BY_CHANCE);
    }
    return others_noisy;
}

static bool broken(current_sense_monitor_t *m, const idle_sample_t *sample, bool switching)
{
    current_sense_channel_t *c = &m->channel[sample->phase];
    const uint16_t code = sample->code;
    if (code != c->last_code) {
        c->equal_codes = 0;
        c->last_code = code;
    } else if (c->equal_codes < UINT16_MAX) {
        c->equal_codes++;
    }
    note_spread(c, code);
    const uint32_t zero = sample->zero;
    const bool off = switching && (code > zero + WRONG_MIN || code + WRONG_MIN < zero);
    c->off_samples = off ? (uint16_t)(c->off_samples + 1U) : 0U;
    return c->off_samples >= WRONG_TICKS || (c->equal_codes >= WINDOW && frozen(m, c, WINDOW));
}

void current_sense_monitor_step(current_sense_monitor_t *monitor, const idle_sample_t *samples, bool switching,
                                evidence_t *evidence)
{
    for (const idle_sample_t *sample = samples; sample < samples + IDLE_SAMPLES; sample++) {
        if (sample->valid && broken(monitor, sample, switching)) {
            evidence->confirmed |= FOUND(FINDING_CURRENT_SENSE_FAILED);
        }
    }
}

/* A single sample off the offset is no evidence: its high side may have begun with the duty of the previous period. */
void current_sense_monitor_suspect(const current_sense_monitor_t *monitor, evidence_t *evidence)
{
    for (uint16_t x = 0; x < OBSERVED_PHASES; x++) {
        const current_sense_channel_t *c = &monitor->channel[x];
        if (c->off_samples > 1U || frozen(monitor, c, SAME_SUSPECT)) {
            evidence->suspected |= SUSPECT_CURRENT_SENSE;
        }
        if (frozen(monitor, c, SAME_REPEATING)) {
            evidence->repeating = (uint16_t)(evidence->repeating | (UINT16_C(1) << x));
        }
    }
}

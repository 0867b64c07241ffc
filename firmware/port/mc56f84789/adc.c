/* adc.c - six parallel conversions in two halves (DRM F35): a trigger starts the scan, it pauses, the other resumes it. */
#include "port/mc56f84789/drivers.h"

#define M1 0U
#define M2 1U

/* Samples of each half: the currents, then the bus voltage. */
#define FIRST_HALF (ADC_SAMPLES_MASK(PAIR_M1_CURRENTS, 1U) | BIT(PAIR_BUS_1))
#define SECOND_HALF (ADC_SAMPLES_MASK(PAIR_M2_CURRENTS, 1U) | BIT(PAIR_BUS_2))
#define BOTH_HALVES (FIRST_HALF | SECOND_HALF)

/* ---- channel lists ---------------------------------------------------------------------------------------------- */

/* Channels of a pair of phases: converter A, converter B. The shunts of phase b reach both converters. */
typedef struct {
    uint16_t a;
    uint16_t b;
} channels_t;

static const channels_t channels[HAL_AXES][3] = {
    {{CHANNEL_M1_A, CHANNEL_M1_B2}, {CHANNEL_M1_B, CHANNEL_M1_C}, {CHANNEL_M1_A, CHANNEL_M1_C}},
    {{CHANNEL_M2_A, CHANNEL_M2_B2}, {CHANNEL_M2_B, CHANNEL_M2_C}, {CHANNEL_M2_A, CHANNEL_M2_C}},
};

static void write_lists(hal_t *hal)
{
    const channels_t *m1 = &channels[M1][hal->axis[M1].pair];
    const channels_t *m2 = &channels[M2][hal->axis[M2].pair];
    REG_WRITE(hal, ADC_CLIST(0U),
              ADC_CLIST_SAMPLE(PAIR_M1_CURRENTS, m1->a) | ADC_CLIST_SAMPLE(PAIR_M2_OFFSETS, m2->a) |
                  ADC_CLIST_SAMPLE(PAIR_BUS_1, CHANNEL_BUS) | ADC_CLIST_SAMPLE(PAIR_M2_CURRENTS, m2->a));
    REG_WRITE(hal, ADC_CLIST(1U), ADC_CLIST_SAMPLE(PAIR_M1_OFFSETS, m1->a) | ADC_CLIST_SAMPLE(PAIR_BUS_2, CHANNEL_BUS));
    REG_WRITE(hal, ADC_CLIST(2U),
              ADC_CLIST_SAMPLE(PAIR_M1_CURRENTS, m1->b) | ADC_CLIST_SAMPLE(PAIR_M2_OFFSETS, m2->b) |
                  ADC_CLIST_SAMPLE(PAIR_BUS_1, CHANNEL_SINK_1) | ADC_CLIST_SAMPLE(PAIR_M2_CURRENTS, m2->b));
    REG_WRITE(hal, ADC_CLIST(3U),
              ADC_CLIST_SAMPLE(PAIR_M1_OFFSETS, m1->b) | ADC_CLIST_SAMPLE(PAIR_BUS_2, CHANNEL_SINK_2));
}

/* The lists may be changed while the scan pauses: the remaining samples use the new lists. */
void hal_adc_select(hal_t *hal, uint16_t axis, phase_pair_t pair)
{
    if (hal->axis[axis].pair != pair) {
        hal->axis[axis].pair = pair;
        write_lists(hal);
    }
}

/* ---- set up ----------------------------------------------------------------------------------------------------- */

bool adc_init(hal_t *hal)
{
    REG_WRITE(hal, ADC_CTRL1, SET_ADC_CTRL1_STOPPED);
    REG_WRITE(hal, ADC_CTRL2, SET_ADC_CTRL2_STOPPED);
    REG_WRITE(hal, ADC_PWR2, SET_ADC_PWR2);
    REG_WRITE(hal, ADC_CTRL3, 0U); /* shortest sample window */
    REG_WRITE(hal, ADC_CAL, 0U); /* the supply is the reference: 0 .. 3.3 V */
    REG_WRITE(hal, ADC_GC1, 0U);
    REG_WRITE(hal, ADC_GC2, 0U);
    REG_WRITE(hal, ADC_ZXCTRL1, 0U);
    REG_WRITE(hal, ADC_ZXCTRL2, 0U);
    for (uint16_t sample = 0; sample < ADC_SAMPLES; sample++) {
        REG_WRITE(hal, ADC_OFFST(sample), 0U); /* plain codes: the application subtracts the offsets */
    }
    write_lists(hal);
    REG_WRITE(hal, ADC_SDIS, SET_ADC_SDIS);
    REG_WRITE(hal, ADC_SCTRL, SET_ADC_SCTRL);
    REG_WRITE(hal, ADC_SCHLTEN, 0U);

    REG_WRITE(hal, ADC_PWR, REG_READ(hal, ADC_PWR) & (uint16_t)~(ADC_PWR_PD0 | ADC_PWR_PD1));
    return wait_for(hal, ADC_PWR, ADC_PWR_PSTS0 | ADC_PWR_PSTS1, 0U);
}

static void drop_results(hal_t *hal)
{
    for (uint16_t pair = 0; pair < 2U * ADC_PAIRS; pair++) {
        (void)REG_READ(hal, ADC_RSLT(pair));
        (void)REG_READ(hal, ADC_RSLT(8U + pair));
    }
}

void adc_stop(hal_t *hal)
{
    REG_WRITE(hal, ADC_CTRL1, SET_ADC_CTRL1_STOPPED);
    REG_WRITE(hal, ADC_CTRL2, SET_ADC_CTRL2_STOPPED);
}

/* After this call the next trigger is that of motor 1. */
void adc_arm(hal_t *hal)
{
    drop_results(hal);
    REG_WRITE(hal, ADC_STAT, SET_ADC_STAT_CLEAR);
    REG_WRITE(hal, ADC_CTRL2, SET_ADC_CTRL2);
    REG_WRITE(hal, ADC_CTRL1, SET_ADC_CTRL1_ARMED);
}

/* ---- results ---------------------------------------------------------------------------------------------------- */

static uint16_t code(hal_t *hal, uint16_t sample)
{
    return (uint16_t)((REG_READ(hal, ADC_RSLT(sample)) & ADC_RSLT_MASK) >> ADC_RSLT_SHIFT);
}

/* Pair CA: converter A samples phase a, the second phase of the pair. */
static adc_pair_t phases(hal_t *hal, uint16_t axis, uint16_t pair)
{
    const uint16_t a = code(hal, pair);
    const uint16_t b = code(hal, (uint16_t)(8U + pair));
    adc_pair_t codes = {a, b};
    if (hal->axis[axis].pair == PHASE_PAIR_CA) {
        codes.first = b;
        codes.second = a;
    }
    return codes;
}

/* A lost trigger would swap the motors permanently: unread results show which half of the scan is complete. */
static bool half_done(hal_t *hal, uint16_t half) { return (REG_READ(hal, ADC_RDY) & BOTH_HALVES) == half; }

bool adc_take_first(hal_t *hal)
{
    if (!half_done(hal, FIRST_HALF)) {
        return false;
    }
    hal->axis[M1].currents = phases(hal, M1, PAIR_M1_CURRENTS);
    hal->bus = code(hal, PAIR_BUS_1);
    return true;
}

bool adc_take_second(hal_t *hal)
{
    if (!half_done(hal, SECOND_HALF)) {
        return false;
    }
    hal->axis[M2].currents = phases(hal, M2, PAIR_M2_CURRENTS);
    hal->bus = code(hal, PAIR_BUS_2);
    return true;
}

adc_pair_t hal_adc_currents(hal_t *hal, uint16_t axis) { return hal->axis[axis].currents; }

/* The results remain valid until the same half of the next period. */
adc_pair_t hal_adc_offsets(hal_t *hal, uint16_t axis)
{
    return phases(hal, axis, (axis == M1) ? PAIR_M1_OFFSETS : PAIR_M2_OFFSETS);
}

uint16_t hal_adc_bus(hal_t *hal) { return hal->bus; }

uint16_t hal_adc_temperature(hal_t *hal, uint16_t axis)
{
    return code(hal, 8U + ((axis == M1) ? PAIR_BUS_1 : PAIR_BUS_2));
}

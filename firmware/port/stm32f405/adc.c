/* adc.c - three converters: the currents of a motor, the offsets of the other one and the bus at a time (README.md). */
#include "port/stm32f405/drivers.h"

#define START_US 10U /* of a converter, at least 3 us */
#define REG_FLAGS (ADC_SR_AWD | ADC_SR_EOC | ADC_SR_JEOC | ADC_SR_JSTRT | ADC_SR_STRT | ADC_SR_OVR)
#define POLLS 8U /* of the second converter: both end in the same clock */

static const uint32_t bases[] = {ADC1_BASE, ADC2_BASE, ADC3_BASE};

/* ---- set up ----------------------------------------------------------------------------------------------------- */

void adc_init(hal_t *hal)
{
    REG_WRITE(hal, ADC_COMMON_BASE + ADC_COMMON_CCR, SET_ADC_COMMON_CCR);
    for (uint16_t i = 0; i < sizeof bases / sizeof bases[0]; i++) {
        REG_WRITE(hal, bases[i] + ADC_CR1, (bases[i] == ADC2_BASE) ? SET_ADC2_CR1 : SET_ADC_CR1);
        REG_WRITE(hal, bases[i] + ADC_CR2, ADC_CR2_ADON);
        REG_WRITE(hal, bases[i] + ADC_SMPR1, 0U);
        REG_WRITE(hal, bases[i] + ADC_SMPR2, 0U);
        REG_WRITE(hal, bases[i] + ADC_SQR2, 0U);
    }
    REG_WRITE(hal, ADC1_BASE + ADC_SMPR1, SET_ADC1_SMPR1);
    REG_WRITE(hal, ADC1_BASE + ADC_SMPR2, SET_ADC1_SMPR2);
    REG_WRITE(hal, ADC1_BASE + ADC_JSQR, SET_ADC1_JSQR);
    REG_WRITE(hal, ADC1_BASE + ADC_SQR1, 0U);
    REG_WRITE(hal, ADC1_BASE + ADC_SQR3, SET_ADC1_SQR3);
    REG_WRITE(hal, ADC2_BASE + ADC_JSQR, SET_ADC_JSQR(CHANNEL_M1_B, CHANNEL_M2_B));
    REG_WRITE(hal, ADC2_BASE + ADC_SQR1, SET_ADC_SQR1_TWO);
    REG_WRITE(hal, ADC2_BASE + ADC_SQR3, SET_ADC_SQR3(CHANNEL_M2_B, CHANNEL_M1_B));
    REG_WRITE(hal, ADC3_BASE + ADC_JSQR, SET_ADC_JSQR(CHANNEL_M1_C, CHANNEL_M2_C));
    REG_WRITE(hal, ADC3_BASE + ADC_SQR1, SET_ADC_SQR1_TWO);
    REG_WRITE(hal, ADC3_BASE + ADC_SQR3, SET_ADC_SQR3(CHANNEL_M2_C, CHANNEL_M1_C));
    wait_clocks(hal, CLOCKS_OF_US(START_US));
}

/* A stream of two words in a circle. */
static void stream_start(hal_t *hal, uint32_t stream, uint32_t set, uint32_t from, const volatile uint16_t *to)
{
    REG_WRITE(hal, DMA2_BASE + DMA_SCR(stream), 0U);
    (void)wait_for(hal, DMA2_BASE + DMA_SCR(stream), DMA_SCR_EN, 0U);
    REG_WRITE(hal, DMA2_BASE + DMA_IFCR(stream), DMA_ISR_ALL(stream));
    REG_WRITE(hal, DMA2_BASE + DMA_SPAR(stream), from + ADC_DR);
    REG_WRITE(hal, DMA2_BASE + DMA_SM0AR(stream), BUS_ADDRESS(to));
    REG_WRITE(hal, DMA2_BASE + DMA_SNDTR(stream), 2U);
    REG_WRITE(hal, DMA2_BASE + DMA_SCR(stream), set | DMA_SCR_EN);
}

/* After this call the next triggers begin their sequences. An overrun ends the requests to DMA until they are switched
 * off and on again. */
void adc_arm(hal_t *hal)
{
    for (uint16_t i = 0; i < sizeof bases / sizeof bases[0]; i++) {
        REG_WRITE(hal, bases[i] + ADC_CR2, ADC_CR2_ADON);
        REG_WRITE(hal, bases[i] + ADC_SR, 0U);
    }
    stream_start(hal, STREAM_ADC2, SET_DMA_ADC2, ADC2_BASE, hal->dma->adc2);
    stream_start(hal, STREAM_ADC3, SET_DMA_ADC3, ADC3_BASE, hal->dma->adc3);
    REG_WRITE(hal, ADC1_BASE + ADC_CR2, SET_ADC1_CR2);
    REG_WRITE(hal, ADC2_BASE + ADC_CR2, SET_ADC_CR2_PHASES);
    REG_WRITE(hal, ADC3_BASE + ADC_CR2, SET_ADC_CR2_PHASES);
}

/* ---- results ---------------------------------------------------------------------------------------------------- */

/* True if a converter has ended its injected sequence; the flag is cleared. */
static bool injected_done(hal_t *hal, uint32_t base)
{
    for (uint16_t poll = 0; poll < POLLS; poll++) {
        if ((REG_READ(hal, base + ADC_SR) & ADC_SR_JEOC) != 0U) {
            REG_WRITE(hal, base + ADC_SR, REG_FLAGS & ~(ADC_SR_JEOC | ADC_SR_JSTRT));
            return true;
        }
    }
    return false;
}

bool adc_take_m1(hal_t *hal)
{
    const bool b = injected_done(hal, ADC2_BASE);
    const bool c = injected_done(hal, ADC3_BASE);
    if (!b || !c) {
        return false;
    }
    hal->axis[M1].currents.first = (uint16_t)REG_READ(hal, ADC2_BASE + ADC_JDR1);
    hal->axis[M1].currents.second = (uint16_t)REG_READ(hal, ADC3_BASE + ADC_JDR1);
    hal->axis[M2].offsets.first = (uint16_t)REG_READ(hal, ADC2_BASE + ADC_JDR2);
    hal->axis[M2].offsets.second = (uint16_t)REG_READ(hal, ADC3_BASE + ADC_JDR2);
    hal->bus = (uint16_t)REG_READ(hal, ADC1_BASE + ADC_JDR1);
    return true;
}

/* True if a stream has copied both words; the flag is cleared. */
static bool copied(hal_t *hal, uint32_t stream)
{
    for (uint16_t poll = 0; poll < POLLS; poll++) {
        if ((REG_READ(hal, DMA2_BASE + DMA_ISR(stream)) & DMA_ISR_TCIF(stream)) != 0U) {
            REG_WRITE(hal, DMA2_BASE + DMA_IFCR(stream), DMA_ISR_ALL(stream));
            return true;
        }
    }
    return false;
}

bool adc_take_m2(hal_t *hal)
{
    const bool b = copied(hal, STREAM_ADC2);
    const bool c = copied(hal, STREAM_ADC3);
    const uint32_t lost = (REG_READ(hal, ADC2_BASE + ADC_SR) | REG_READ(hal, ADC3_BASE + ADC_SR)) & ADC_SR_OVR;
    if (!b || !c || lost != 0U) {
        return false;
    }
    hal->axis[M2].currents.first = hal->dma->adc2[0];
    hal->axis[M2].currents.second = hal->dma->adc3[0];
    hal->axis[M1].offsets.first = hal->dma->adc2[1];
    hal->axis[M1].offsets.second = hal->dma->adc3[1];
    hal->bus = (uint16_t)REG_READ(hal, ADC1_BASE + ADC_DR);
    return true;
}

static bool beyond(int32_t codes) { return codes > OVER_CURRENT_CODES || codes < -OVER_CURRENT_CODES; }

/* The limit of the board. The current of phase a is that of the other two. */
bool over_current(const hal_t *hal, uint16_t axis)
{
    const int32_t b = (int32_t)hal->axis[axis].currents.first - ADC_MIDDLE;
    const int32_t c = (int32_t)hal->axis[axis].currents.second - ADC_MIDDLE;
    return beyond(b) || beyond(c) || beyond(b + c);
}

/* The shunts are in phases b and c. */
void hal_adc_select(hal_t *hal, uint16_t axis, phase_pair_t pair)
{
    (void)hal;
    (void)axis;
    (void)pair;
}

adc_pair_t hal_adc_currents(hal_t *hal, uint16_t axis) { return hal->axis[axis].currents; }

adc_pair_t hal_adc_offsets(hal_t *hal, uint16_t axis) { return hal->axis[axis].offsets; }

uint16_t hal_adc_bus(hal_t *hal) { return hal->bus; }

uint16_t hal_adc_temperature(hal_t *hal, uint16_t axis)
{
    return (uint16_t)REG_READ(hal, ADC1_BASE + ((axis == M1) ? ADC_JDR2 : ADC_JDR3));
}

#include "stm32f405/adc.h"

#include "port/stm32f405/registers.h"

#define MODULE_SIZE 0x100u
#define COMMON (ADC_COMMON_BASE - ADC1_BASE)
#define JOFR1 0x14u /* registers and bits which the port does not use */
#define JOFR4 0x20u
#define CR1_AWDCH 0x1Fu
#define CR1_AWDIE 0x40u
#define CR1_AWDSGL 0x200u
#define CR1_JAWDEN 0x400000u
#define CR1_AWDEN 0x800000u
#define CR1_MODELLED                                                                                                   \
    (CR1_AWDCH | ADC_CR1_EOCIE | CR1_AWDIE | ADC_CR1_JEOCIE | ADC_CR1_SCAN | CR1_AWDSGL | CR1_JAWDEN | CR1_AWDEN |     \
     ADC_CR1_OVRIE)
#define CR2_JSWSTART 0x400000u
#define CR2_SWSTART 0x40000000u
#define CR2_MODELLED                                                                                                   \
    (ADC_CR2_ADON | ADC_CR2_CONT | ADC_CR2_DMA | ADC_CR2_DDS | ADC_CR2_EOCS | FIELD_MASK(ADC_CR2_JEXTSEL) |            \
     FIELD_MASK(ADC_CR2_JEXTEN) | CR2_JSWSTART | FIELD_MASK(ADC_CR2_EXTSEL) | FIELD_MASK(ADC_CR2_EXTEN) | CR2_SWSTART)
#define SR_FLAGS 0x3Fu
#define CODES 0xFFFu
#define PINS_OF_CONVERTER 16u /* inputs 0 to 15 */
#define CONVERSION 12u /* clocks of the converter */

static const char *const names[SOC_ADCS] = {"ADC1", "ADC2", "ADC3"};
static const uint8_t sample_clocks[8] = {3, 15, 28, 56, 84, 112, 144, 255}; /* 255: 480 */

/* Sources of JEXTSEL and EXTSEL; SOC_TIMERS: not modelled. */
static const struct {
    uint8_t timer, trigger;
} injected_source[16] =
    {
        {SOC_TIM1, SOC_TRIGGER_CC4}, {SOC_TIM1, SOC_TRIGGER_TRGO},
        {SOC_TIM2, SOC_TRIGGER_CC1}, {SOC_TIM2, SOC_TRIGGER_TRGO},
        {SOC_TIM3, SOC_TRIGGER_CC2}, {SOC_TIM3, SOC_TRIGGER_CC4},
        {SOC_TIM4, SOC_TRIGGER_CC1}, {SOC_TIM4, SOC_TRIGGER_CC2},
        {SOC_TIM4, SOC_TRIGGER_CC3}, {SOC_TIM4, SOC_TRIGGER_TRGO},
        {SOC_TIM5, SOC_TRIGGER_CC4}, {SOC_TIM5, SOC_TRIGGER_TRGO},
        {SOC_TIM8, SOC_TRIGGER_CC2}, {SOC_TIM8, SOC_TRIGGER_CC3},
        {SOC_TIM8, SOC_TRIGGER_CC4}, {SOC_TIMERS, 0},
    },
  regular_source[16] = {
      {SOC_TIM1, SOC_TRIGGER_CC1},  {SOC_TIM1, SOC_TRIGGER_CC2},
      {SOC_TIM1, SOC_TRIGGER_CC3},  {SOC_TIM2, SOC_TRIGGER_CC2},
      {SOC_TIM2, SOC_TRIGGER_CC3},  {SOC_TIM2, SOC_TRIGGER_CC4},
      {SOC_TIM2, SOC_TRIGGER_TRGO}, {SOC_TIM3, SOC_TRIGGER_CC1},
      {SOC_TIM3, SOC_TRIGGER_TRGO}, {SOC_TIM4, SOC_TRIGGER_CC4},
      {SOC_TIM5, SOC_TRIGGER_CC1},  {SOC_TIM5, SOC_TRIGGER_CC2},
      {SOC_TIM5, SOC_TRIGGER_CC3},  {SOC_TIM8, SOC_TRIGGER_CC1},
      {SOC_TIM8, SOC_TRIGGER_TRGO}, {SOC_TIMERS, 0},
  };

/* Clocks of 168 MHz per clock of the converter. */
static uint64_t clocks(const adc_t *adc)
{
    return (uint64_t)SOC_APB2_CLOCKS * 2u * (FIELD_GET(adc->ccr, ADC_COMMON_CCR_ADCPRE) + 1u);
}

static bool edge_selected(uint32_t enable, bool rising) { return (enable & (rising ? 1u : 2u)) != 0; }

static void request(adc_t *adc)
{
    bool any = false;
    for (unsigned n = 0; n < SOC_ADCS; n++) {
        const adc_module_t *m = &adc->module[n];
        any = any || ((m->sr & ADC_SR_EOC) != 0 && (m->cr1 & ADC_CR1_EOCIE) != 0) ||
              ((m->sr & ADC_SR_JEOC) != 0 && (m->cr1 & ADC_CR1_JEOCIE) != 0) ||
              ((m->sr & ADC_SR_AWD) != 0 && (m->cr1 & CR1_AWDIE) != 0) ||
              ((m->sr & ADC_SR_OVR) != 0 && (m->cr1 & ADC_CR1_OVRIE) != 0);
    }
    soc_request(adc->soc, SOC_IRQ_ADC, 0, any);
}

/* ---- sequences ------------------------------------------------------------------------------------------------------ */

static unsigned conversions(const adc_module_t *m, adc_group_t group)
{
    if ((m->cr1 & ADC_CR1_SCAN) == 0) {
        return 1u;
    }
    return 1u + ((group == ADC_INJECTED) ? FIELD_GET(m->jsqr, ADC_JSQR_JL) : FIELD_GET(m->sqr[0], ADC_SQR1_L));
}

/* Channel of a rank. A sequence of k injected conversions begins with JSQ(5 - k). */
static unsigned channel_of(const adc_module_t *m)
{
    if (m->runs == ADC_INJECTED) {
        return m->jsqr >> (5u * (3u - FIELD_GET(m->jsqr, ADC_JSQR_JL) + m->rank)) & 0x1Fu;
    }
    return m->sqr[2u - m->rank / 6u] >> (5u * (m->rank % 6u)) & 0x1Fu;
}

static uint32_t sampling(const adc_module_t *m, unsigned channel)
{
    const uint32_t code =
        (channel < 10u) ? m->smpr[1] >> (3u * channel) & 7u : m->smpr[0] >> (3u * (channel - 10u)) & 7u;
    return (code < 7u) ? sample_clocks[code] : 480u;
}

static void plan(adc_t *adc, unsigned n, uint64_t converter_clocks)
{
    bus_plan(&adc->soc->bus, SOC_EVENT_ADC + n, adc->soc->bus.now + converter_clocks * clocks(adc));
}

static void begin(adc_t *adc, unsigned n, adc_group_t group, unsigned rank, uint64_t delay)
{
    adc_module_t *m = &adc->module[n];
    m->runs = group;
    m->rank = rank;
    m->held = false;
    const unsigned channel = channel_of(m);
    if (channel >= PINS_OF_CONVERTER || (n == 2u && channel > 3u && channel < 10u) || (n == 2u && channel > 13u)) {
        bus_fail(&adc->soc->bus, "%s converts channel %u, which is not modelled", names[n], channel);
    }
    plan(adc, n, delay + sampling(m, channel));
}

static void start(adc_t *adc, unsigned n, adc_group_t group)
{
    adc_module_t *m = &adc->module[n];
    soc_need_clock(adc->soc, names[n]);
    if ((m->cr2 & ADC_CR2_ADON) == 0 || m->runs == group || (group == ADC_REGULAR && m->regular_waits)) {
        return; /* a trigger during the same sequence is lost */
    }
    m->sr |= (group == ADC_INJECTED) ? ADC_SR_JSTRT : ADC_SR_STRT;
    if (m->runs == ADC_NOTHING) {
        begin(adc, n, group, 0, ADC_LATENCY);
    } else if (group == ADC_INJECTED) {
        m->regular_waits = true;
        m->regular_rank = m->rank;
        begin(adc, n, group, 0, ADC_LATENCY);
    } else {
        m->regular_waits = true;
        m->regular_rank = 0;
    }
}

static void watch(adc_module_t *m, unsigned channel, bool injected)
{
    const bool on = (m->cr1 & (injected ? CR1_JAWDEN : CR1_AWDEN)) != 0;
    const bool selected = (m->cr1 & CR1_AWDSGL) == 0 || (m->cr1 & CR1_AWDCH) == channel;
    if (on && selected && (m->code > m->htr || m->code < m->ltr)) {
        m->sr |= ADC_SR_AWD;
    }
}

static void regular_result(adc_t *adc, unsigned n, bool last)
{
    adc_module_t *m = &adc->module[n];
    const bool watched = (m->cr2 & (ADC_CR2_DMA | ADC_CR2_EOCS)) != 0;
    if (watched && (m->sr & ADC_SR_OVR) != 0) {
        return; /* until the flag is cleared */
    }
    if (watched && (m->sr & ADC_SR_EOC) != 0) {
        m->sr |= ADC_SR_OVR;
        return;
    }
    m->dr = m->code;
    if ((m->cr2 & (ADC_CR2_EOCS | ADC_CR2_DMA)) != 0 || last) {
        m->sr |= ADC_SR_EOC;
    }
    if ((m->cr2 & ADC_CR2_DMA) != 0) {
        adc->soc->signals->dma_request(adc->soc->chip, (soc_dma_t)(SOC_DMA_ADC1 + n), true);
    }
}

static void finish(adc_t *adc, unsigned n)
{
    adc_module_t *m = &adc->module[n];
    const bool injected = m->runs == ADC_INJECTED;
    const unsigned rank = m->rank;
    const bool last = rank + 1u >= conversions(m, m->runs);
    watch(m, channel_of(m), injected);
    if (injected) {
        m->jdr[rank] = (uint32_t)((int32_t)m->code - (int32_t)m->jofr[rank]) & 0xFFFFu;
        m->sr |= last ? ADC_SR_JEOC : 0u;
    } else {
        regular_result(adc, n, last);
    }
    if (!last) {
        begin(adc, n, m->runs, rank + 1u, 0);
        return;
    }
    m->runs = ADC_NOTHING;
    if (injected && m->regular_waits) {
        m->regular_waits = false;
        begin(adc, n, ADC_REGULAR, m->regular_rank, 0);
    } else if (!injected && (m->cr2 & ADC_CR2_CONT) != 0) {
        begin(adc, n, ADC_REGULAR, 0, 0);
    }
}

void adc_event(void *peripheral, unsigned source)
{
    adc_t *adc = (adc_t *)peripheral;
    const unsigned n = source - SOC_EVENT_ADC;
    adc_module_t *m = &adc->module[n];
    bus_plan(&adc->soc->bus, source, CHIP_NEVER);
    if (m->runs == ADC_NOTHING) {
        return;
    }
    if (!m->held) {
        const unsigned channel = channel_of(m);
        bus_sync_plant(&adc->soc->bus);
        m->code = adc->soc->bus.environment->convert(adc->soc->bus.board, channel);
        m->held = true;
        bus_note(&adc->soc->bus, TRACE_SAMPLE, 16u * n + channel, channel);
        plan(adc, n, CONVERSION);
    } else {
        finish(adc, n);
        request(adc);
    }
}

void adc_trigger(adc_t *adc, soc_timer_t timer, soc_trigger_t trigger, bool rising)
{
    for (unsigned n = 0; n < SOC_ADCS; n++) {
        const adc_module_t *m = &adc->module[n];
        const unsigned j = FIELD_GET(m->cr2, ADC_CR2_JEXTSEL), r = FIELD_GET(m->cr2, ADC_CR2_EXTSEL);
        if (edge_selected(FIELD_GET(m->cr2, ADC_CR2_JEXTEN), rising) && injected_source[j].timer == timer &&
            injected_source[j].trigger == trigger) {
            start(adc, n, ADC_INJECTED);
        }
        if (edge_selected(FIELD_GET(m->cr2, ADC_CR2_EXTEN), rising) && regular_source[r].timer == timer &&
            regular_source[r].trigger == trigger) {
            start(adc, n, ADC_REGULAR);
        }
    }
}

/* ---- registers ------------------------------------------------------------------------------------------------------ */

static uint32_t read_module(adc_t *adc, unsigned n, uint32_t offset)
{
    adc_module_t *m = &adc->module[n];
    switch (offset) {
    case ADC_SR:
        return m->sr;
    case ADC_CR1:
        return m->cr1;
    case ADC_CR2:
        return m->cr2;
    case ADC_SMPR1:
    case ADC_SMPR2:
        return m->smpr[(offset - ADC_SMPR1) / 4u];
    case ADC_HTR:
        return m->htr;
    case ADC_LTR:
        return m->ltr;
    case ADC_SQR1:
    case ADC_SQR2:
    case ADC_SQR3:
        return m->sqr[(offset - ADC_SQR1) / 4u];
    case ADC_JSQR:
        return m->jsqr;
    case ADC_DR:
        m->sr &= ~ADC_SR_EOC;
        adc->soc->signals->dma_request(adc->soc->chip, (soc_dma_t)(SOC_DMA_ADC1 + n), false);
        request(adc);
        return m->dr;
    default:
        if (offset >= JOFR1 && offset <= JOFR4) {
            return m->jofr[(offset - JOFR1) / 4u];
        }
        if (offset >= ADC_JDR1 && offset <= ADC_JDR4) {
            return m->jdr[(offset - ADC_JDR1) / 4u];
        }
        soc_no_register(adc->soc, names[n], offset);
    }
}

uint32_t adc_read(void *peripheral, uint32_t offset)
{
    adc_t *adc = (adc_t *)peripheral;
    const unsigned n = offset / MODULE_SIZE;
    if (n < SOC_ADCS) {
        soc_check_gate(adc->soc, names[n], SOC_APB2, 8u + n);
        return read_module(adc, n, offset % MODULE_SIZE);
    }
    if (offset == COMMON + ADC_COMMON_CSR) {
        return adc->module[0].sr | adc->module[1].sr << 8 | adc->module[2].sr << 16;
    }
    if (offset != COMMON + ADC_COMMON_CCR) {
        soc_no_register(adc->soc, "ADC common", offset - COMMON);
    }
    return adc->ccr;
}

static void write_cr2(adc_t *adc, unsigned n, uint32_t value)
{
    adc_module_t *m = &adc->module[n];
    soc_allow(adc->soc, names[n], ADC_CR2, value, CR2_MODELLED, "left alignment is not modelled");
    if ((FIELD_GET(value, ADC_CR2_JEXTEN) != 0 &&
         injected_source[FIELD_GET(value, ADC_CR2_JEXTSEL)].timer == SOC_TIMERS) ||
        (FIELD_GET(value, ADC_CR2_EXTEN) != 0 &&
         regular_source[FIELD_GET(value, ADC_CR2_EXTSEL)].timer == SOC_TIMERS)) {
        soc_no_value(adc->soc, names[n], ADC_CR2, value, "EXTI lines as triggers are not modelled");
    }
    m->cr2 = value & ~(CR2_JSWSTART | CR2_SWSTART);
    if ((value & ADC_CR2_ADON) == 0) {
        m->runs = ADC_NOTHING;
        m->regular_waits = false;
        bus_plan(&adc->soc->bus, SOC_EVENT_ADC + n, CHIP_NEVER);
    }
    if ((value & CR2_JSWSTART) != 0) {
        start(adc, n, ADC_INJECTED);
    }
    if ((value & CR2_SWSTART) != 0) {
        start(adc, n, ADC_REGULAR);
    }
}

static void write_module(adc_t *adc, unsigned n, uint32_t offset, uint32_t value)
{
    adc_module_t *m = &adc->module[n];
    switch (offset) {
    case ADC_SR:
        m->sr &= value & SR_FLAGS;
        break;
    case ADC_CR1:
        soc_allow(adc->soc, names[n], offset, value, CR1_MODELLED,
                  "automatic, discontinuous and coarser conversions are not modelled");
        m->cr1 = value;
        break;
    case ADC_CR2:
        write_cr2(adc, n, value);
        break;
    case ADC_SMPR1:
    case ADC_SMPR2:
        m->smpr[(offset - ADC_SMPR1) / 4u] = value;
        break;
    case ADC_HTR:
        m->htr = value & CODES;
        break;
    case ADC_LTR:
        m->ltr = value & CODES;
        break;
    case ADC_SQR1:
    case ADC_SQR2:
    case ADC_SQR3:
        m->sqr[(offset - ADC_SQR1) / 4u] = value;
        break;
    case ADC_JSQR:
        m->jsqr = value;
        break;
    default:
        if (offset < JOFR1 || offset > JOFR4) {
            soc_no_register(adc->soc, names[n], offset);
        }
        m->jofr[(offset - JOFR1) / 4u] = value & CODES;
        break;
    }
}

void adc_write(void *peripheral, uint32_t offset, uint32_t value)
{
    adc_t *adc = (adc_t *)peripheral;
    const unsigned n = offset / MODULE_SIZE;
    if (n < SOC_ADCS) {
        soc_check_gate(adc->soc, names[n], SOC_APB2, 8u + n);
        write_module(adc, n, offset % MODULE_SIZE, value);
    } else if (offset == COMMON + ADC_COMMON_CCR) {
        soc_allow(adc->soc, "ADC common", ADC_COMMON_CCR, value, FIELD_MASK(ADC_COMMON_CCR_ADCPRE),
                  "multiple modes and internal channels are not modelled");
        if (FIELD_GET(value, ADC_COMMON_CCR_ADCPRE) == 0) {
            soc_no_value(adc->soc, "ADC common", ADC_COMMON_CCR, value, "42 MHz are above the limit of 36 MHz");
        }
        adc->ccr = value;
    } else {
        soc_no_register(adc->soc, "ADC common", offset - COMMON);
    }
    request(adc);
}

void adc_reset(void *peripheral, soc_reset_t cause)
{
    adc_t *adc = (adc_t *)peripheral;
    (void)cause;
    for (unsigned n = 0; n < SOC_ADCS; n++) {
        adc->module[n] = (adc_module_t){.htr = CODES};
        adc->soc->signals->dma_request(adc->soc->chip, (soc_dma_t)(SOC_DMA_ADC1 + n), false);
        bus_plan(&adc->soc->bus, SOC_EVENT_ADC + n, CHIP_NEVER);
    }
    adc->ccr = 0;
    request(adc);
}

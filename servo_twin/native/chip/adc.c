#include "chip/adc.h"

enum {
    CTRL1 = 0x00,
    CTRL2 = 0x01,
    ZXCTRL1 = 0x02,
    ZXCTRL2 = 0x03,
    CLIST1 = 0x04,
    CLIST4 = 0x07,
    SDIS = 0x08,
    STAT = 0x09,
    RDY = 0x0A,
    LOLIMSTAT = 0x0B,
    ZXSTAT = 0x0D,
    RSLT0 = 0x0E,
    LOLIM0 = 0x1E,
    HILIM0 = 0x2E,
    OFFST0 = 0x3E,
    PWR = 0x4E,
    CAL = 0x4F,
    GC1 = 0x50,
    GC2 = 0x51,
    SCTRL = 0x52,
    PWR2 = 0x53,
    CTRL3 = 0x54,
    SCHLTEN = 0x55
};

#define CTRL_STOP 0x4000u
#define CTRL_START 0x2000u
#define CTRL_SYNC 0x1000u
#define CTRL_EOSIE 0x0800u
#define CTRL1_SMODE(x) ((x) & 7u)
#define CTRL2_SIMULT 0x0040u
#define CTRL2_DIV0(x) ((x) & 0x3Fu)
#define SMODE_ONCE_PARALLEL 1u
#define SMODE_TRIGGERED_PARALLEL 5u
#define STAT_EOSI 0x1800u
#define PWR_PUDELAY(x) (((x) >> 4) & 0x3Fu)

#define A 0u
#define B 1u

static bool together(const adc_t *adc) { return (adc->reg[CTRL2] & CTRL2_SIMULT) != 0; }

static uint16_t control(const adc_t *adc, unsigned c) { return (c == A) ? adc->reg[CTRL1] : adc->reg[CTRL2]; }

/* Bus clocks per clock of a converter. */
static uint64_t divider(const adc_t *adc, unsigned c)
{
    const unsigned div = (c == A || together(adc)) ? CTRL2_DIV0(adc->reg[CTRL2]) : (adc->reg[PWR2] >> 8) & 0x3Fu;
    return (div == 0) ? 2u : div + 1u;
}

static bool powered(const adc_t *adc, unsigned c)
{
    return ((adc->reg[PWR] >> c) & 1u) == 0 && adc->bus->now >= adc->power_clock[c];
}

/* Results that are ready. */
NOINLINE static void settle(adc_t *adc)
{
    unsigned done = 0;
    for (unsigned remaining = adc->waits; remaining != 0; remaining &= remaining - 1u) {
        const unsigned n = lowest_bit(remaining);
        if (adc->ready[n] <= adc->bus->now) {
            adc->reg[RSLT0 + n] = adc->waiting[n];
            done |= 1u << n;
        }
    }
    adc->reg[RDY] = (uint16_t)(adc->reg[RDY] | done);
    adc->waits &= ~done;
}

NOINLINE static void request(adc_t *adc)
{
    const bool end_a = (adc->reg[STAT] & 0x0800u) != 0 && (adc->reg[CTRL1] & CTRL_EOSIE) != 0;
    const bool end_b = (adc->reg[STAT] & 0x1000u) != 0 && (adc->reg[CTRL2] & CTRL_EOSIE) != 0;
    const unsigned halted = adc->reg[RDY] & adc->reg[SCHLTEN];
    bus_request(adc->bus, VECTOR_ADC_CC0, end_a || (halted & (together(adc) ? 0xFFFFu : 0x00FFu)) != 0);
    bus_request(adc->bus, VECTOR_ADC_CC1, !together(adc) && (end_b || (halted & 0xFF00u) != 0));
}

/* When a sample is ready whose interrupt stops the scan. */
NOINLINE static uint64_t next_halt(const adc_t *adc)
{
    uint64_t next = CHIP_NEVER;
    for (unsigned remaining = adc->waits & adc->reg[SCHLTEN]; remaining != 0; remaining &= remaining - 1u) {
        const uint64_t ready = adc->ready[lowest_bit(remaining)];
        next = (ready < next) ? ready : next;
    }
    return next;
}

static inline void schedule(adc_t *adc, unsigned c)
{
    const adc_converter_t *converter = &adc->converter[c];
    const uint64_t halt = (adc->reg[SCHLTEN] != 0) ? next_halt(adc) : CHIP_NEVER;
    uint64_t next = CHIP_NEVER;
    if (converter->converting) {
        next = (converter->sample_clock < converter->end_clock) ? converter->sample_clock : converter->end_clock;
    }
    bus_plan(adc->bus, SOURCE_ADC + c, (halt < next) ? halt : next);
}

/* The samples of a converter that a pair consists of. */
static inline unsigned samples_of(const adc_t *adc, unsigned c, unsigned pair)
{
    const unsigned first = together(adc) ? 0x0101u : (c == A) ? 0x0001u : 0x0100u;
    return first << pair;
}

/* A scan ends before the first pair of which a sample is disabled. */
static inline bool disabled(const adc_t *adc, unsigned c, unsigned pair)
{
    return (adc->reg[SDIS] & samples_of(adc, c, pair)) != 0;
}

/* Start with the first pair, or with the next one after a pause. */
static void begin_row(adc_t *adc, unsigned c, uint64_t from)
{
    static const uint8_t most_mhz[4] = {5, 10, 15, 20};
    adc_converter_t *converter = &adc->converter[c];
    const uint64_t div = divider(adc, c);
    const unsigned speed = (adc->reg[PWR2] >> (2u * c)) & 3u;
    if (CHIP_BUS_HZ / 1000000u > most_mhz[speed] * div) {
        bus_fail(adc->bus, "ADC: a clock of %lu MHz with SPEED%c = %u (up to %u MHz)",
                 (unsigned long)(CHIP_BUS_HZ / 1000000u / div), "AB"[c], speed, most_mhz[speed]);
    }
    if (disabled(adc, c, converter->pair)) {
        bus_fail(adc->bus, "ADC: a scan without samples (SDIS = %04Xh) is not modelled", (unsigned)adc->reg[SDIS]);
    }
    const uint64_t edge = (from + div - 1u) / div * div;
    converter->scanning = true;
    converter->converting = true;
    converter->sample_clock = edge + (5u * div + 1u) / 2u;
    converter->ready_clock = edge + (17u * div + 1u) / 2u;
    converter->end_clock = CHIP_NEVER;
    schedule(adc, c);
}

void adc_sync(adc_t *adc, unsigned c)
{
    if (c == B && together(adc)) {
        return; /* A starts both */
    }
    adc_converter_t *converter = &adc->converter[c];
    const uint64_t at = adc->bus->now + adc->bus->crossbar_clocks;
    if (converter->sync_clock == at) {
        return; /* two triggers of one clock are one pulse */
    }
    converter->sync_clock = at;
    const uint16_t ctrl = control(adc, c);
    const bool accepted = bus_gate_open(adc->bus, 2, 7) && (ctrl & CTRL_STOP) == 0 && (ctrl & CTRL_SYNC) != 0 &&
                          powered(adc, c) && !converter->converting &&
                          (CTRL1_SMODE(adc->reg[CTRL1]) == SMODE_TRIGGERED_PARALLEL || converter->scanning);
    bus_note(adc->bus, TRACE_SYNC, c, accepted ? 1u : 0u);
    if (accepted) {
        begin_row(adc, c, at);
    }
}

static inline void take_sample(adc_t *adc, unsigned n, uint64_t ready)
{
    const unsigned c = n / ADC_PAIRS;
    const unsigned channel = adc->channel[n];
    if (channel / ADC_PAIRS != c) {
        bus_fail(adc->bus, "ADC: sample %u of converter %c takes an input of the other one (CLIST)", n, "AB"[c]);
    }
    bus_note(adc->bus, TRACE_SAMPLE, n, channel);
    bus_sync_plant(adc->bus);
    const bool connected = ((adc->connected >> channel) & 1u) != 0;
    const uint16_t code = connected ? adc->bus->environment->convert(adc->bus->board, channel) : 0u;
    if (((adc->waits >> n) & 1u) != 0) {
        settle(adc);
    }
    adc->waiting[n] = (uint16_t)((unsigned)code * 8u - adc->reg[OFFST0 + n]);
    adc->ready[n] = ready;
    adc->waits |= 1u << n;
}

static void end_scan(adc_t *adc, unsigned c)
{
    adc_converter_t *converter = &adc->converter[c];
    settle(adc);
    converter->scanning = converter->converting = false;
    converter->pair = 0;
    converter->sample_clock = converter->end_clock = CHIP_NEVER;
    adc->reg[STAT] = (uint16_t)(adc->reg[STAT] | (0x0800u << c));
    bus_note(adc->bus, TRACE_SCAN_END, c, 0);
    request(adc);
}

void adc_event(void *peripheral, unsigned source)
{
    adc_t *adc = (adc_t *)peripheral;
    const unsigned c = source - SOURCE_ADC;
    adc_converter_t *converter = &adc->converter[c];
    if (converter->converting && converter->sample_clock <= adc->bus->now) {
        const uint64_t ready = converter->ready_clock;
        const unsigned pair = converter->pair++;
        const unsigned samples = samples_of(adc, c, pair) & ((c == A) ? 0xFFFFu : 0xFF00u);
        for (unsigned remaining = samples; remaining != 0; remaining &= remaining - 1u) {
            take_sample(adc, lowest_bit(remaining), ready);
        }
        const unsigned next = converter->pair;
        const bool last = next == ADC_PAIRS || disabled(adc, c, next);
        if (last || ((adc->reg[SCTRL] >> next) & 1u) != 0) {
            converter->sample_clock = CHIP_NEVER;
            converter->end_clock = ready;
        } else {
            const uint64_t step = 6u * divider(adc, c);
            converter->sample_clock += step;
            converter->ready_clock += step;
        }
    } else if (converter->converting && converter->end_clock <= adc->bus->now) {
        const unsigned next = converter->pair;
        if (next == ADC_PAIRS || disabled(adc, c, next)) {
            end_scan(adc, c);
        } else {
            converter->converting = false; /* paused */
            converter->end_clock = CHIP_NEVER;
        }
    }
    if (adc->reg[SCHLTEN] != 0) {
        settle(adc);
        request(adc);
    }
    schedule(adc, c);
}

/* ---- registers ------------------------------------------------------------------------------------------------------- */

static void stop(adc_t *adc, unsigned c)
{
    adc_converter_t *converter = &adc->converter[c];
    converter->scanning = converter->converting = false;
    converter->pair = 0;
    converter->sample_clock = converter->end_clock = CHIP_NEVER;
    adc->waits &= (c == A) ? ~0x00FFu : ~0xFF00u;
    if (together(adc)) {
        adc->waits = 0;
    }
    schedule(adc, c);
}

static void begin(adc_t *adc, unsigned c)
{
    const adc_converter_t *converter = &adc->converter[c];
    if (!powered(adc, c)) {
        bus_fail(adc->bus, "ADC: a scan begins while converter %c is powered down", "AB"[c]);
    }
    if (!converter->converting) {
        begin_row(adc, c, adc->bus->now);
    }
}

static void check_scan(adc_t *adc, uint32_t address, uint16_t value)
{
    const unsigned mode = CTRL1_SMODE(adc->reg[CTRL1]);
    if (mode != SMODE_ONCE_PARALLEL && mode != SMODE_TRIGGERED_PARALLEL) {
        bus_no_value(adc->bus, address, value, "only parallel scans, once or triggered, are modelled");
    }
}

static void set_power(adc_t *adc, uint16_t value)
{
    for (unsigned c = 0; c < ADC_CONVERTERS; c++) {
        const bool was_down = ((adc->reg[PWR] >> c) & 1u) != 0;
        const bool down = ((value >> c) & 1u) != 0;
        if (was_down && !down) {
            adc->power_clock[c] = adc->bus->now + PWR_PUDELAY(value) * divider(adc, c);
        }
        if (down) {
            stop(adc, c);
        }
    }
    adc->reg[PWR] = (uint16_t)(value & ~0x0C00u);
}

uint16_t adc_read(void *peripheral, uint32_t address)
{
    adc_t *adc = (adc_t *)peripheral;
    const uint32_t number = address - ADC_BASE;
    bus_check_gate(adc->bus, address, 2, 7);
    if (adc->waits != 0) {
        settle(adc);
    }
    if (number >= RSLT0 && number < LOLIM0) {
        const unsigned n = number - RSLT0;
        adc->reg[RDY] = (uint16_t)(adc->reg[RDY] & ~(1u << n));
        if (adc->reg[SCHLTEN] != 0) {
            request(adc);
        }
        return adc->reg[RSLT0 + n];
    }
    if (number >= LOLIM0 && number < OFFST0) {
        bus_no_register(adc->bus, address);
    }
    if (number == STAT) {
        return (uint16_t)(adc->reg[STAT] | (adc->converter[A].scanning ? 0x8000u : 0u) |
                          (adc->converter[together(adc) ? A : B].scanning ? 0x4000u : 0u));
    }
    if (number == PWR) {
        return (uint16_t)(adc->reg[PWR] | (powered(adc, A) ? 0u : 0x0400u) | (powered(adc, B) ? 0u : 0x0800u));
    }
    return adc->reg[number];
}

/* The channels of four samples. */
static void set_channels(adc_t *adc, unsigned list, uint16_t value)
{
    adc->reg[CLIST1 + list] = value;
    for (unsigned i = 0; i < 4u; i++) {
        adc->channel[4u * list + i] = (uint8_t)((value >> (4u * i)) & 0xFu);
    }
}

static void write_ctrl(adc_t *adc, uint32_t address, unsigned c, uint16_t value)
{
    const uint16_t kept = (uint16_t)(value & ~CTRL_START);
    if (c == A) {
        bus_allow(adc->bus, address, value, 0x7807, "differential inputs, limits and DMA are not modelled");
        adc->reg[CTRL1] = kept;
    } else {
        bus_allow(adc->bus, address, value, 0x787F, "differential inputs and DMA are not modelled");
        adc->reg[CTRL2] = kept;
    }
    if ((value & CTRL_STOP) != 0) {
        if (c == A || !together(adc)) {
            stop(adc, c);
        }
    } else {
        check_scan(adc, address, value);
        if ((value & CTRL_START) != 0 && (c == A || !together(adc))) {
            begin(adc, c);
        }
    }
    request(adc);
}

void adc_write(void *peripheral, uint32_t address, uint16_t value)
{
    adc_t *adc = (adc_t *)peripheral;
    const uint32_t number = address - ADC_BASE;
    bus_check_gate(adc->bus, address, 2, 7);
    settle(adc);
    if (number >= OFFST0 && number < PWR) {
        adc->reg[number] = value & 0x7FF8u;
        return;
    }
    if (number >= CLIST1 && number <= CLIST4) {
        set_channels(adc, number - CLIST1, value);
        return;
    }
    if (number >= LOLIM0 && number < HILIM0) {
        bus_allow(adc->bus, address, value, 0, "limits are not modelled");
        return;
    }
    if (number >= HILIM0 && number < OFFST0) {
        if (value != 0x7FF8) {
            bus_no_value(adc->bus, address, value, "limits are not modelled");
        }
        return;
    }
    switch (number) {
    case CTRL1:
        write_ctrl(adc, address, A, value);
        break;
    case CTRL2:
        write_ctrl(adc, address, B, value);
        break;
    case SDIS:
        adc->reg[SDIS] = value;
        break;
    case STAT:
        adc->reg[STAT] = (uint16_t)(adc->reg[STAT] & ~(value & STAT_EOSI));
        request(adc);
        break;
    case ZXCTRL1:
    case ZXCTRL2:
    case GC1:
    case GC2:
        bus_allow(adc->bus, address, value, 0, "zero crossing and gain are not modelled");
        break;
    case LOLIMSTAT:
    case LOLIMSTAT + 1:
    case ZXSTAT:
        break; /* clears what is never set */
    case PWR:
        bus_allow(adc->bus, address, value, 0x1FF7, "automatic power-down is not modelled");
        set_power(adc, value);
        break;
    case CAL:
        bus_allow(adc->bus, address, value, 0, "external references are not modelled");
        break;
    case SCTRL:
        bus_allow(adc->bus, address, value, 0x000F, "pauses from pair 4 on: sources disagree about the bits");
        adc->reg[SCTRL] = value;
        break;
    case PWR2:
        adc->reg[PWR2] = value & 0x3F0Fu;
        break;
    case CTRL3:
        bus_allow(adc->bus, address, value, 0, "longer sample windows and DMA are not modelled");
        adc->reg[CTRL3] = value;
        break;
    case SCHLTEN:
        adc->reg[SCHLTEN] = value;
        request(adc);
        schedule(adc, A);
        schedule(adc, B);
        break;
    default:
        bus_no_register(adc->bus, address);
    }
}

void adc_reset(void *peripheral)
{
    adc_t *adc = (adc_t *)peripheral;
    *adc = (adc_t){
        .bus = adc->bus,
        .connected = adc->connected,
        .reg = {[CTRL1] = 0x5005, [CTRL2] = 0x5044, [SDIS] = 0xF0F0, [PWR] = 0x11A7, [PWR2] = 0x0400},
        .converter = {{.sample_clock = CHIP_NEVER, .end_clock = CHIP_NEVER, .sync_clock = CHIP_NEVER},
                      {.sample_clock = CHIP_NEVER, .end_clock = CHIP_NEVER, .sync_clock = CHIP_NEVER}},
    };
    set_channels(adc, 0, 0x3210);
    set_channels(adc, 1, 0x7654);
    set_channels(adc, 2, 0xBA98);
    set_channels(adc, 3, 0xFEDC);
}

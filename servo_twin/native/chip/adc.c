#include "chip/adc.h"

#include "chip/parts.h"

#define BASE 0xE500u

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

static bool together(const adc_t *adc) { return (adc->ctrl2 & CTRL2_SIMULT) != 0; }

static uint16_t control(const adc_t *adc, unsigned c) { return (c == A) ? adc->ctrl1 : adc->ctrl2; }

/* Bus clocks per clock of a converter. */
static uint64_t divider(const adc_t *adc, unsigned c)
{
    const unsigned div = (c == A || together(adc)) ? CTRL2_DIV0(adc->ctrl2) : (adc->pwr2 >> 8) & 0x3Fu;
    return (div == 0) ? 2u : div + 1u;
}

static bool powered(const chip_t *chip, unsigned c)
{
    const adc_t *adc = &chip->adc;
    return ((adc->pwr >> c) & 1u) == 0 && chip->now >= adc->power_clock[c];
}

/* Results whose time has come. */
NOINLINE static void settle(chip_t *chip)
{
    adc_t *adc = &chip->adc;
    unsigned come = 0;
    for (unsigned left = adc->waits; left != 0; left &= left - 1u) {
        const unsigned n = chip_lowest_bit(left);
        if (adc->ready[n] <= chip->now) {
            adc->result[n] = adc->waiting[n];
            come |= 1u << n;
        }
    }
    adc->rdy = (uint16_t)(adc->rdy | come);
    adc->waits &= ~come;
}

NOINLINE static void request(chip_t *chip)
{
    const adc_t *adc = &chip->adc;
    const bool end_a = (adc->stat & 0x0800u) != 0 && (adc->ctrl1 & CTRL_EOSIE) != 0;
    const bool end_b = (adc->stat & 0x1000u) != 0 && (adc->ctrl2 & CTRL_EOSIE) != 0;
    const unsigned halted = adc->rdy & adc->schlten;
    intc_request(chip, VECTOR_ADC_CC0, end_a || (halted & (together(adc) ? 0xFFFFu : 0x00FFu)) != 0);
    intc_request(chip, VECTOR_ADC_CC1, !together(adc) && (end_b || (halted & 0xFF00u) != 0));
}

/* When a sample is ready whose interrupt stops the scan. */
NOINLINE static uint64_t next_halt(const adc_t *adc)
{
    uint64_t next = CHIP_NEVER;
    for (unsigned left = adc->waits & adc->schlten; left != 0; left &= left - 1u) {
        const uint64_t ready = adc->ready[chip_lowest_bit(left)];
        next = (ready < next) ? ready : next;
    }
    return next;
}

static inline void schedule(chip_t *chip, unsigned c)
{
    const adc_t *adc = &chip->adc;
    const adc_converter_t *converter = &adc->converter[c];
    const uint64_t halt = (adc->schlten != 0) ? next_halt(adc) : CHIP_NEVER;
    uint64_t next = CHIP_NEVER;
    if (converter->converting) {
        next = (converter->hold_clock < converter->end_clock) ? converter->hold_clock : converter->end_clock;
    }
    chip_schedule(chip, SOURCE_ADC + c, (halt < next) ? halt : next);
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
    return (adc->sdis & samples_of(adc, c, pair)) != 0;
}

/* The first pair of a row. */
static void begin_row(chip_t *chip, unsigned c, uint64_t from)
{
    static const uint8_t most_mhz[4] = {5, 10, 15, 20};
    adc_t *adc = &chip->adc;
    adc_converter_t *converter = &adc->converter[c];
    const uint64_t div = divider(adc, c);
    const unsigned speed = (adc->pwr2 >> (2u * c)) & 3u;
    if (CHIP_BUS_HZ / 1000000u > most_mhz[speed] * div) {
        chip_fail(chip, "ADC: a clock of %lu MHz with SPEED%c = %u (up to %u MHz)",
                  (unsigned long)(CHIP_BUS_HZ / 1000000u / div), "AB"[c], speed, most_mhz[speed]);
    }
    if (disabled(adc, c, converter->pair)) {
        chip_fail(chip, "ADC: a scan without samples (SDIS = %04Xh) is not modelled", (unsigned)adc->sdis);
    }
    const uint64_t edge = (from + div - 1u) / div * div;
    converter->scanning = true;
    converter->converting = true;
    converter->hold_clock = edge + (5u * div + 1u) / 2u;
    converter->ready_clock = edge + (17u * div + 1u) / 2u;
    converter->end_clock = CHIP_NEVER;
    schedule(chip, c);
}

void adc_sync(chip_t *chip, unsigned c)
{
    adc_t *adc = &chip->adc;
    if (c == B && together(adc)) {
        return; /* B obeys A */
    }
    adc_converter_t *converter = &adc->converter[c];
    const uint64_t at = chip->now + chip->config.crossbar_clocks;
    if (converter->sync_clock == at) {
        return; /* two triggers of one clock are one pulse */
    }
    converter->sync_clock = at;
    const uint16_t ctrl = control(adc, c);
    const bool obeyed = sim_gate_open(chip, 2, 7) && (ctrl & CTRL_STOP) == 0 && (ctrl & CTRL_SYNC) != 0 &&
                        powered(chip, c) && !converter->converting &&
                        (CTRL1_SMODE(adc->ctrl1) == SMODE_TRIGGERED_PARALLEL || converter->scanning);
    chip_note(chip, TRACE_SYNC, c, obeyed ? 1u : 0u);
    if (obeyed) {
        begin_row(chip, c, at);
    }
}

static inline void hold(chip_t *chip, unsigned n, uint64_t ready)
{
    adc_t *adc = &chip->adc;
    const unsigned c = n / ADC_PAIRS;
    const unsigned channel = adc->channel[n];
    if (channel / ADC_PAIRS != c) {
        chip_fail(chip, "ADC: sample %u of converter %c takes an input of the other one (CLIST)", n, "AB"[c]);
    }
    chip_note(chip, TRACE_SAMPLE, n, channel);
    sync_plant(chip);
    const bool connected = ((chip->pins.analog >> channel) & 1u) != 0;
    const uint16_t code = connected ? world_convert(chip->world, channel) : 0u;
    if (((adc->waits >> n) & 1u) != 0) {
        settle(chip);
    }
    adc->waiting[n] = (uint16_t)((unsigned)code * 8u - adc->offset[n]);
    adc->ready[n] = ready;
    adc->waits |= 1u << n;
}

static void end_scan(chip_t *chip, unsigned c)
{
    adc_t *adc = &chip->adc;
    adc_converter_t *converter = &adc->converter[c];
    settle(chip);
    converter->scanning = converter->converting = false;
    converter->pair = 0;
    converter->hold_clock = converter->end_clock = CHIP_NEVER;
    adc->stat = (uint16_t)(adc->stat | (0x0800u << c));
    chip_note(chip, TRACE_SCAN_END, c, 0);
    request(chip);
}

void adc_event(chip_t *chip, unsigned c)
{
    adc_t *adc = &chip->adc;
    adc_converter_t *converter = &adc->converter[c];
    if (converter->converting && converter->hold_clock <= chip->now) {
        const uint64_t ready = converter->ready_clock;
        const unsigned pair = converter->pair++;
        const unsigned samples = samples_of(adc, c, pair) & ((c == A) ? 0xFFFFu : 0xFF00u);
        for (unsigned left = samples; left != 0; left &= left - 1u) {
            hold(chip, chip_lowest_bit(left), ready);
        }
        const unsigned next = converter->pair;
        const bool last = next == ADC_PAIRS || disabled(adc, c, next);
        if (last || ((adc->sctrl >> next) & 1u) != 0) {
            converter->hold_clock = CHIP_NEVER;
            converter->end_clock = ready;
        } else {
            const uint64_t step = 6u * divider(adc, c);
            converter->hold_clock += step;
            converter->ready_clock += step;
        }
    } else if (converter->converting && converter->end_clock <= chip->now) {
        const unsigned next = converter->pair;
        if (next == ADC_PAIRS || disabled(adc, c, next)) {
            end_scan(chip, c);
        } else {
            converter->converting = false; /* paused */
            converter->end_clock = CHIP_NEVER;
        }
    }
    if (adc->schlten != 0) {
        settle(chip);
        request(chip);
    }
    schedule(chip, c);
}

/* ---- registers ------------------------------------------------------------------------------------------------------- */

static void stop(chip_t *chip, unsigned c)
{
    adc_converter_t *converter = &chip->adc.converter[c];
    converter->scanning = converter->converting = false;
    converter->pair = 0;
    converter->hold_clock = converter->end_clock = CHIP_NEVER;
    chip->adc.waits &= (c == A) ? ~0x00FFu : ~0xFF00u;
    if (together(&chip->adc)) {
        chip->adc.waits = 0;
    }
    schedule(chip, c);
}

static void begin(chip_t *chip, unsigned c)
{
    const adc_converter_t *converter = &chip->adc.converter[c];
    if (!powered(chip, c)) {
        chip_fail(chip, "ADC: a scan begins while converter %c is powered down", "AB"[c]);
    }
    if (!converter->converting) {
        begin_row(chip, c, chip->now);
    }
}

static void check_scan(chip_t *chip, uint32_t address, uint16_t value)
{
    const unsigned mode = CTRL1_SMODE(chip->adc.ctrl1);
    if (mode != SMODE_ONCE_PARALLEL && mode != SMODE_TRIGGERED_PARALLEL) {
        chip_no_value(chip, address, value, "only parallel scans, once or triggered, are modelled");
    }
}

static void set_power(chip_t *chip, uint16_t value)
{
    adc_t *adc = &chip->adc;
    for (unsigned c = 0; c < ADC_CONVERTERS; c++) {
        const bool was_down = ((adc->pwr >> c) & 1u) != 0;
        const bool down = ((value >> c) & 1u) != 0;
        if (was_down && !down) {
            adc->power_clock[c] = chip->now + PWR_PUDELAY(value) * divider(adc, c);
        }
        if (down) {
            stop(chip, c);
        }
    }
    adc->pwr = (uint16_t)(value & ~0x0C00u);
}

uint16_t adc_read(chip_t *chip, uint32_t address)
{
    adc_t *adc = &chip->adc;
    const uint32_t r = address - BASE;
    sim_gate(chip, address, 2, 7);
    if (adc->waits != 0) {
        settle(chip);
    }
    if (r >= RSLT0 && r < LOLIM0) {
        const unsigned n = r - RSLT0;
        adc->rdy = (uint16_t)(adc->rdy & ~(1u << n));
        if (adc->schlten != 0) {
            request(chip);
        }
        return adc->result[n];
    }
    if (r >= OFFST0 && r < PWR) {
        return adc->offset[r - OFFST0];
    }
    if (r >= CLIST1 && r <= CLIST4) {
        return adc->clist[r - CLIST1];
    }
    switch (r) {
    case CTRL1:
        return adc->ctrl1;
    case CTRL2:
        return adc->ctrl2;
    case SDIS:
        return adc->sdis;
    case STAT:
        return (uint16_t)(adc->stat | (adc->converter[A].scanning ? 0x8000u : 0u) |
                          (adc->converter[together(adc) ? A : B].scanning ? 0x4000u : 0u));
    case RDY:
        return adc->rdy;
    case PWR:
        return (uint16_t)(adc->pwr | (powered(chip, A) ? 0u : 0x0400u) | (powered(chip, B) ? 0u : 0x0800u));
    case CAL:
        return adc->cal;
    case ZXCTRL1:
    case ZXCTRL2:
    case GC1:
    case GC2:
    case LOLIMSTAT:
    case LOLIMSTAT + 1:
    case ZXSTAT:
        return 0;
    case SCTRL:
        return adc->sctrl;
    case PWR2:
        return adc->pwr2;
    case CTRL3:
        return adc->ctrl3;
    case SCHLTEN:
        return adc->schlten;
    default:
        chip_no_register(chip, address);
    }
}

/* The channels of four samples. */
static void set_channels(adc_t *adc, unsigned list, uint16_t value)
{
    adc->clist[list] = value;
    for (unsigned i = 0; i < 4u; i++) {
        adc->channel[4u * list + i] = (uint8_t)((value >> (4u * i)) & 0xFu);
    }
}

static void write_ctrl(chip_t *chip, uint32_t address, unsigned c, uint16_t value)
{
    adc_t *adc = &chip->adc;
    const uint16_t kept = (uint16_t)(value & ~CTRL_START);
    if (c == A) {
        chip_only(chip, address, value, 0x7807, "differential inputs, limits and DMA are not modelled");
        adc->ctrl1 = kept;
    } else {
        chip_only(chip, address, value, 0x787F, "differential inputs and DMA are not modelled");
        adc->ctrl2 = kept;
    }
    if ((value & CTRL_STOP) != 0) {
        if (c == A || !together(adc)) {
            stop(chip, c);
        }
    } else {
        check_scan(chip, address, value);
        if ((value & CTRL_START) != 0 && (c == A || !together(adc))) {
            begin(chip, c);
        }
    }
    request(chip);
}

void adc_write(chip_t *chip, uint32_t address, uint16_t value)
{
    adc_t *adc = &chip->adc;
    const uint32_t r = address - BASE;
    sim_gate(chip, address, 2, 7);
    settle(chip);
    if (r >= OFFST0 && r < PWR) {
        adc->offset[r - OFFST0] = value & 0x7FF8u;
        return;
    }
    if (r >= CLIST1 && r <= CLIST4) {
        set_channels(adc, r - CLIST1, value);
        return;
    }
    if (r >= LOLIM0 && r < HILIM0) {
        chip_only(chip, address, value, 0, "limits are not modelled");
        return;
    }
    if (r >= HILIM0 && r < OFFST0) {
        if (value != 0x7FF8) {
            chip_no_value(chip, address, value, "limits are not modelled");
        }
        return;
    }
    switch (r) {
    case CTRL1:
        write_ctrl(chip, address, A, value);
        break;
    case CTRL2:
        write_ctrl(chip, address, B, value);
        break;
    case SDIS:
        adc->sdis = value;
        break;
    case STAT:
        adc->stat = (uint16_t)(adc->stat & ~(value & STAT_EOSI));
        request(chip);
        break;
    case ZXCTRL1:
    case ZXCTRL2:
    case GC1:
    case GC2:
        chip_only(chip, address, value, 0, "zero crossing and gain are not modelled");
        break;
    case LOLIMSTAT:
    case LOLIMSTAT + 1:
    case ZXSTAT:
        break; /* clears what is never set */
    case PWR:
        chip_only(chip, address, value, 0x1FF7, "automatic power-down is not modelled");
        set_power(chip, value);
        break;
    case CAL:
        chip_only(chip, address, value, 0, "external references are not modelled");
        break;
    case SCTRL:
        chip_only(chip, address, value, 0x000F, "pauses from pair 4 on: sources disagree about the bits");
        adc->sctrl = value;
        break;
    case PWR2:
        adc->pwr2 = value & 0x3F0Fu;
        break;
    case CTRL3:
        chip_only(chip, address, value, 0, "longer sample windows and DMA are not modelled");
        adc->ctrl3 = value;
        break;
    case SCHLTEN:
        adc->schlten = value;
        request(chip);
        schedule(chip, A);
        schedule(chip, B);
        break;
    default:
        chip_no_register(chip, address);
    }
}

void adc_reset(chip_t *chip)
{
    chip->adc = (adc_t){
        .ctrl1 = 0x5005,
        .ctrl2 = 0x5044,
        .sdis = 0xF0F0,
        .pwr = 0x11A7, /* without the status bits */
        .pwr2 = 0x0400,
        .converter = {{.hold_clock = CHIP_NEVER, .end_clock = CHIP_NEVER, .sync_clock = CHIP_NEVER},
                      {.hold_clock = CHIP_NEVER, .end_clock = CHIP_NEVER, .sync_clock = CHIP_NEVER}},
    };
    set_channels(&chip->adc, 0, 0x3210);
    set_channels(&chip->adc, 1, 0x7654);
    set_channels(&chip->adc, 2, 0xBA98);
    set_channels(&chip->adc, 3, 0xFEDC);
}

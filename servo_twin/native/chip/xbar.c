#include "chip/xbar.h"

#define A_BASE XBAR_BASE
#define A_CTRL0 0xE35Eu
#define B_BASE 0xE360u
#define B_END 0xE368u
#define AOI_BASE 0xE380u
#define FIRST_EVENT_INPUT 46u

/* Outputs of crossbar A by the inputs that they drive. */
enum {
    OUT_XB4 = 4,
    OUT_XB11 = 11,
    OUT_ADCA = 12,
    OUT_ADCB = 13,
    OUT_PWMA_SYNC = 24,
    OUT_FAULT0 = 29,
    OUT_TB0 = 34,
    OUT_TA0 = 49,
    OUT_PWMB_SYNC = 53
};

void xbar_reset(void *peripheral)
{
    xbar_t *xbar = (xbar_t *)peripheral;
    *xbar = (xbar_t){.bus = xbar->bus, .level = 2}; /* input 1 is the supply */
}

static unsigned a_select(const xbar_t *xbar, unsigned output)
{
    return (xbar->a_select[output / 2u] >> (8u * (output % 2u))) & 0x3Fu;
}

static unsigned b_select(const xbar_t *xbar, unsigned output)
{
    return (xbar->b_select[output / 2u] >> (8u * (output % 2u))) & 0x1Fu;
}

/* ---- AOI ------------------------------------------------------------------------------------------------------------- */

/* OR of four products of the inputs A to D; code of an input: 0 force 0, 1 pass, 2 invert, 3 force 1. */
static bool sum_of_products(const uint16_t bfcrt[2], unsigned inputs)
{
    for (unsigned term = 0; term < 4u; term++) {
        const unsigned codes = bfcrt[term / 2u] >> ((term % 2u == 0) ? 8u : 0u);
        bool product = true;
        for (unsigned i = 0; i < 4u; i++) {
            const unsigned code = (codes >> (6u - 2u * i)) & 3u;
            const bool level = ((inputs >> i) & 1u) != 0;
            product = product && ((code == 1u) ? level : (code == 2u) ? !level : code == 3u);
        }
        if (product) {
            return true;
        }
    }
    return false;
}

static bool evaluate(const xbar_t *xbar, unsigned event, unsigned inputs)
{
    return ((xbar->truth[event] >> ((inputs >> (4u * event)) & 0xFu)) & 1u) != 0;
}

/* ---- signals ---------------------------------------------------------------------------------------------------------- */

NOINLINE static void drive_fault(xbar_t *xbar, unsigned input, xbar_edge_t edge)
{
    const chip_signals_t *signals = xbar->bus->signals;
    void *chip = xbar->bus->chip;
    const bool level = edge == XBAR_RISE;
    if (edge == XBAR_PULSE) {
        bus_fail(xbar->bus, "XBARA: a pulse of one clock at a fault input is not modelled");
    }
    if (((xbar->bus->sim.ips0 >> input) & 1u) != 0) {
        signals->pwm_fault(chip, 0, input, level);
    }
    if (input < 3u && ((xbar->bus->sim.ips0 >> (4u + input)) & 1u) != 0) {
        signals->pwm_fault(chip, 1, input, level);
    }
}

NOINLINE static void drive_timer(xbar_t *xbar, unsigned module, unsigned input, xbar_edge_t edge)
{
    const chip_signals_t *signals = xbar->bus->signals;
    void *chip = xbar->bus->chip;
    if (input < QTMR_CHANNELS && ((xbar->bus->sim.ips0 >> (8u + 4u * module + input)) & 1u) != 0) {
        if (edge == XBAR_PULSE) {
            signals->timer_pulse(chip, module, input);
        } else {
            signals->timer_catch_up(chip);
            signals->timer_input(chip, module, input, edge == XBAR_RISE);
            xbar->bus->environment->deferrable_edges_changed(xbar->bus->board);
        }
    }
}

static void drive_output(xbar_t *xbar, unsigned output, xbar_edge_t edge)
{
    const chip_signals_t *signals = xbar->bus->signals;
    void *chip = xbar->bus->chip;
    if (output == OUT_ADCA || output == OUT_ADCB) {
        if (edge != XBAR_FALL) {
            signals->adc_sync(chip, output - OUT_ADCA);
        }
    } else if (output >= OUT_PWMA_SYNC && output < OUT_PWMA_SYNC + PWM_SUBMODULES) {
        if (edge != XBAR_FALL) {
            signals->pwm_ext_sync(chip, 0, output - OUT_PWMA_SYNC);
        }
    } else if (output >= OUT_PWMB_SYNC && output < OUT_PWMB_SYNC + PWM_SUBMODULES) {
        if (edge != XBAR_FALL) {
            signals->pwm_ext_sync(chip, 1, output - OUT_PWMB_SYNC);
        }
    } else if (output >= OUT_FAULT0 && output < OUT_FAULT0 + PWM_FAULTS) {
        drive_fault(xbar, output - OUT_FAULT0, edge);
    } else if (output >= OUT_TA0) {
        drive_timer(xbar, 0, output - OUT_TA0, edge);
    } else {
        drive_timer(xbar, 1, output - OUT_TB0, edge);
    }
}

static void change_input(xbar_t *xbar, unsigned input, xbar_edge_t edge)
{
    const uint64_t bit = UINT64_C(1) << input;
    if (edge != XBAR_PULSE) {
        xbar->level = (edge == XBAR_RISE) ? (xbar->level | bit) : (xbar->level & ~bit);
    }
    for (uint64_t outputs = xbar->reaches[input]; outputs != 0; outputs &= outputs - 1u) {
        drive_output(xbar, lowest_bit(outputs), edge);
    }
}

/* Inputs of the AOI change; with a pulse back again. */
static void change_aoi(xbar_t *xbar, unsigned before, unsigned after, bool pulse)
{
    if (!pulse) {
        xbar->aoi_in = after;
    }
    for (unsigned event = 0, remaining = before ^ after; remaining != 0; event++, remaining >>= 4u) {
        if ((remaining & 0xFu) == 0) {
            continue;
        }
        const bool from = evaluate(xbar, event, before);
        const bool to = evaluate(xbar, event, after);
        if (from != to) {
            change_input(xbar, FIRST_EVENT_INPUT + event, pulse ? XBAR_PULSE : to ? XBAR_RISE : XBAR_FALL);
        }
    }
}

void xbar_signal(xbar_t *xbar, int a_input, int b_input, xbar_edge_t edge)
{
    if (a_input >= 0) {
        change_input(xbar, (unsigned)a_input, edge);
    }
    if (b_input >= 0) {
        if (edge != XBAR_PULSE) {
            const uint32_t bit = UINT32_C(1) << b_input;
            xbar->b_level = (edge == XBAR_RISE) ? (xbar->b_level | bit) : (xbar->b_level & ~bit);
        }
        const unsigned fed = xbar->feeds[b_input];
        if (fed != 0) {
            const unsigned before = xbar->aoi_in;
            const unsigned after = (edge == XBAR_FALL) ? (before & ~fed) : (before | fed);
            change_aoi(xbar, before, after, edge == XBAR_PULSE);
        }
    }
}

/* ---- registers ------------------------------------------------------------------------------------------------------- */

static bool modelled(unsigned output)
{
    return (output >= OUT_XB4 && output <= OUT_ADCB) || (output >= OUT_PWMA_SYNC && output < OUT_PWMA_SYNC + 4u) ||
           (output >= OUT_FAULT0 && output < OUT_FAULT0 + 4u) || (output >= OUT_TB0 && output < OUT_TB0 + 4u) ||
           (output >= OUT_TA0 && output < OUT_TA0 + 4u) || (output >= OUT_PWMB_SYNC && output < OUT_PWMB_SYNC + 4u);
}

static void a_route(xbar_t *xbar, uint32_t address, uint16_t value)
{
    const unsigned first = 2u * (address - A_BASE);
    uint64_t before[2];
    for (unsigned i = 0; i < 2u; i++) {
        const unsigned input = (value >> (8u * i)) & 0x3Fu;
        if (input >= XBARA_INPUTS || (input != 0 && !modelled(first + i))) {
            bus_no_value(xbar->bus, address, value, "this input or output of the crossbar is not modelled");
        }
        before[i] = xbar->level >> a_select(xbar, first + i) & 1u;
    }
    xbar->a_select[address - A_BASE] = value & 0x3F3Fu;
    for (unsigned input = 0; input < XBARA_INPUTS; input++) {
        xbar->reaches[input] = 0;
    }
    for (unsigned output = 0; output < XBARA_OUTPUTS; output++) {
        xbar->reaches[a_select(xbar, output)] |= UINT64_C(1) << output;
    }
    for (unsigned i = 0; i < 2u && first + i < XBARA_OUTPUTS; i++) {
        const uint64_t after = xbar->level >> a_select(xbar, first + i) & 1u;
        if (after != before[i]) {
            drive_output(xbar, first + i, (after != 0) ? XBAR_RISE : XBAR_FALL);
        }
    }
}

static void b_route(xbar_t *xbar, uint32_t address, uint16_t value)
{
    if ((value & 0x1Fu) >= XBARB_INPUTS || ((value >> 8) & 0x1Fu) >= XBARB_INPUTS) {
        bus_no_value(xbar->bus, address, value, "there is no such input of crossbar B");
    }
    xbar->b_select[address - B_BASE] = value & 0x1F1Fu;
    unsigned levels = 0;
    for (unsigned input = 0; input < XBARB_INPUTS; input++) {
        xbar->feeds[input] = 0;
    }
    for (unsigned output = 0; output < XBARB_OUTPUTS; output++) {
        const unsigned input = b_select(xbar, output);
        xbar->feeds[input] |= 1u << output;
        levels |= ((xbar->b_level >> input) & 1u) << output;
    }
    change_aoi(xbar, xbar->aoi_in, levels, false);
}

static void aoi_write(xbar_t *xbar, uint32_t address, uint16_t value)
{
    const unsigned event = (address - AOI_BASE) / 2u;
    const bool before = evaluate(xbar, event, xbar->aoi_in);
    xbar->bfcrt[address - AOI_BASE] = value;
    xbar->truth[event] = 0;
    for (unsigned inputs = 0; inputs < 16u; inputs++) {
        const unsigned result = sum_of_products(&xbar->bfcrt[2u * event], inputs) ? 1u : 0u;
        xbar->truth[event] = (uint16_t)(xbar->truth[event] | (result << inputs));
    }
    const bool after = evaluate(xbar, event, xbar->aoi_in);
    if (before != after) {
        change_input(xbar, FIRST_EVENT_INPUT + event, after ? XBAR_RISE : XBAR_FALL);
    }
}

uint16_t xbar_read(void *peripheral, uint32_t address)
{
    xbar_t *xbar = (xbar_t *)peripheral;
    if (address < A_CTRL0) {
        return xbar->a_select[address - A_BASE];
    }
    if (address < B_BASE) {
        return 0;
    }
    if (address < B_END) {
        return xbar->b_select[address - B_BASE];
    }
    if (address >= AOI_BASE) {
        return xbar->bfcrt[address - AOI_BASE];
    }
    bus_no_register(xbar->bus, address);
}

void xbar_write(void *peripheral, uint32_t address, uint16_t value)
{
    xbar_t *xbar = (xbar_t *)peripheral;
    if (address < A_CTRL0) {
        a_route(xbar, address, value);
    } else if (address < B_BASE) {
        bus_allow(xbar->bus, address, value, 0, "edges that the crossbar detects are not modelled");
    } else if (address < B_END) {
        b_route(xbar, address, value);
    } else if (address >= AOI_BASE) {
        aoi_write(xbar, address, value);
    } else {
        bus_no_register(xbar->bus, address);
    }
}

#include "chip/xbar.h"

#include "chip/parts.h"

#define A_BASE 0xE340u
#define A_CTRL0 0xE35Eu
#define B_BASE 0xE360u
#define B_END 0xE368u
#define AOI_BASE 0xE380u
#define FIRST_EVENT_INPUT 46u

/* What the outputs of crossbar A lead to. */
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

void xbar_reset(chip_t *chip) { chip->xbar = (xbar_t){.level = 2}; /* input 1 is the supply */ }

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

NOINLINE static void lead_to_fault(chip_t *chip, unsigned input, xbar_edge_t edge)
{
    const bool level = edge == XBAR_RISE;
    if (edge == XBAR_PULSE) {
        chip_fail(chip, "XBARA: a pulse of one clock at a fault input is not modelled");
    }
    if (((chip->sim.ips0 >> input) & 1u) != 0) {
        pwm_fault_input(chip, 0, input, level);
    }
    if (input < 3u && ((chip->sim.ips0 >> (4u + input)) & 1u) != 0) {
        pwm_fault_input(chip, 1, input, level);
    }
}

NOINLINE static void lead_to_timer(chip_t *chip, unsigned module, unsigned input, xbar_edge_t edge)
{
    if (input < QTMR_CHANNELS && ((chip->sim.ips0 >> (8u + 4u * module + input)) & 1u) != 0) {
        if (edge == XBAR_PULSE) {
            qtmr_pulse(chip, module, input);
        } else {
            qtmr_catch_up(chip);
            qtmr_input(chip, module, input, edge == XBAR_RISE, chip->now);
            world_deferrable_edges(chip->world); /* it has used some */
        }
    }
}

static void lead(chip_t *chip, unsigned output, xbar_edge_t edge)
{
    if (output == OUT_ADCA || output == OUT_ADCB) {
        if (edge != XBAR_FALL) {
            adc_sync(chip, output - OUT_ADCA);
        }
    } else if (output >= OUT_PWMA_SYNC && output < OUT_PWMA_SYNC + PWM_SUBMODULES) {
        if (edge != XBAR_FALL) {
            pwm_ext_sync(chip, 0, output - OUT_PWMA_SYNC);
        }
    } else if (output >= OUT_PWMB_SYNC && output < OUT_PWMB_SYNC + PWM_SUBMODULES) {
        if (edge != XBAR_FALL) {
            pwm_ext_sync(chip, 1, output - OUT_PWMB_SYNC);
        }
    } else if (output >= OUT_FAULT0 && output < OUT_FAULT0 + PWM_FAULTS) {
        lead_to_fault(chip, output - OUT_FAULT0, edge);
    } else if (output >= OUT_TA0) {
        lead_to_timer(chip, 0, output - OUT_TA0, edge);
    } else {
        lead_to_timer(chip, 1, output - OUT_TB0, edge);
    }
}

static void follow(chip_t *chip, unsigned input, xbar_edge_t edge)
{
    xbar_t *xbar = &chip->xbar;
    const uint64_t bit = UINT64_C(1) << input;
    if (edge != XBAR_PULSE) {
        xbar->level = (edge == XBAR_RISE) ? (xbar->level | bit) : (xbar->level & ~bit);
    }
    for (uint64_t outputs = xbar->reaches[input]; outputs != 0; outputs &= outputs - 1u) {
        lead(chip, chip_lowest_bit(outputs), edge);
    }
}

/* Inputs of the AOI go from one state to another; a pulse comes back. */
static void combine(chip_t *chip, unsigned before, unsigned after, bool pulse)
{
    xbar_t *xbar = &chip->xbar;
    if (!pulse) {
        xbar->aoi_in = after;
    }
    for (unsigned event = 0, left = before ^ after; left != 0; event++, left >>= 4u) {
        if ((left & 0xFu) == 0) {
            continue;
        }
        const bool from = evaluate(xbar, event, before);
        const bool to = evaluate(xbar, event, after);
        if (from != to) {
            follow(chip, FIRST_EVENT_INPUT + event, pulse ? XBAR_PULSE : to ? XBAR_RISE : XBAR_FALL);
        }
    }
}

void xbar_signal(chip_t *chip, int a_input, int b_input, xbar_edge_t edge)
{
    xbar_t *xbar = &chip->xbar;
    if (a_input >= 0) {
        follow(chip, (unsigned)a_input, edge);
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
            combine(chip, before, after, edge == XBAR_PULSE);
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

static void a_route(chip_t *chip, uint32_t address, uint16_t value)
{
    xbar_t *xbar = &chip->xbar;
    const unsigned first = 2u * (address - A_BASE);
    uint64_t before[2];
    for (unsigned i = 0; i < 2u; i++) {
        const unsigned input = (value >> (8u * i)) & 0x3Fu;
        if (input >= XBARA_INPUTS || (input != 0 && !modelled(first + i))) {
            chip_no_value(chip, address, value, "this input or output of the crossbar is not modelled");
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
            lead(chip, first + i, (after != 0) ? XBAR_RISE : XBAR_FALL);
        }
    }
}

static void b_route(chip_t *chip, uint32_t address, uint16_t value)
{
    xbar_t *xbar = &chip->xbar;
    if ((value & 0x1Fu) >= XBARB_INPUTS || ((value >> 8) & 0x1Fu) >= XBARB_INPUTS) {
        chip_no_value(chip, address, value, "there is no such input of crossbar B");
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
    combine(chip, xbar->aoi_in, levels, false);
}

static void aoi_write(chip_t *chip, uint32_t address, uint16_t value)
{
    xbar_t *xbar = &chip->xbar;
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
        follow(chip, FIRST_EVENT_INPUT + event, after ? XBAR_RISE : XBAR_FALL);
    }
}

uint16_t xbar_read(chip_t *chip, uint32_t address)
{
    const xbar_t *xbar = &chip->xbar;
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
    chip_no_register(chip, address);
}

void xbar_write(chip_t *chip, uint32_t address, uint16_t value)
{
    if (address < A_CTRL0) {
        a_route(chip, address, value);
    } else if (address < B_BASE) {
        chip_only(chip, address, value, 0, "edges that the crossbar detects are not modelled");
    } else if (address < B_END) {
        b_route(chip, address, value);
    } else if (address >= AOI_BASE) {
        aoi_write(chip, address, value);
    } else {
        chip_no_register(chip, address);
    }
}

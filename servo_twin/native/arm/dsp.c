/* Operations of the DSP extension that compilers seldom use, and reversals. */
#include "arm/arm.h"
#include "arm/operations.h"

static int32_t low(uint32_t word) { return (int16_t)(uint16_t)word; }

static int32_t high(uint32_t word) { return (int16_t)(uint16_t)(word >> 16); }

static uint32_t halves(int32_t upper, int32_t lower) { return (uint32_t)upper << 16 | ((uint32_t)lower & 0xFFFFu); }

static uint32_t turn(uint32_t value, unsigned amount)
{
    return (amount == 0u) ? value : value >> amount | value << (32u - amount);
}

static int64_t limited(int64_t value, int64_t min, int64_t max)
{
    return (value < min) ? min : (value > max) ? max : value;
}

/* Saturated to 32 bits; sets Q. */
static int32_t saturated(arm_state_t *s, int64_t value)
{
    const int64_t result = limited(value, INT32_MIN, INT32_MAX);
    s->saturated |= (result != value) ? 1u : 0u;
    return (int32_t)result;
}

static uint32_t reversed_bits(uint32_t value)
{
    uint32_t result = 0;
    for (unsigned k = 0; k < 32u; k++) {
        result |= (value >> k & 1u) << (31u - k);
    }
    return result;
}

/* ---- parallel additions and subtractions ---------------------------------------------------------------------------- */

enum { PLAIN, SATURATING, HALVING };

/* A lane of `width` bits: the result of a sum or difference, and its GE flag. */
static uint32_t lane(int32_t value, unsigned width, bool is_unsigned, uint32_t prefix, bool difference, bool *ge)
{
    const int32_t span = 1 << width;
    *ge = (is_unsigned && !difference) ? value >= span : value >= 0;
    if (prefix == SATURATING) {
        value = (int32_t)(is_unsigned ? limited(value, 0, span - 1) : limited(value, -(span / 2), span / 2 - 1));
    } else if (prefix == HALVING) {
        value >>= 1;
    }
    return (uint32_t)value & (uint32_t)(span - 1);
}

/* x: 0 ADD8, 1 ADD16, 2 ASX, 4 SUB8, 5 SUB16, 6 SAX; y: 0..2 signed, 4..6 unsigned. */
static uint32_t parallel(arm_state_t *s, const arm_op_t *op)
{
    const uint32_t n = s->r[op->n], m = s->r[op->m], prefix = op->y & 3u;
    const bool is_unsigned = (op->y & 4u) != 0u, bytes = (op->x & 3u) == 0u, exchanged = (op->x & 3u) == 2u;
    const unsigned width = bytes ? 8u : 16u, lanes = bytes ? 4u : 2u;
    uint32_t result = 0, flags = 0;
    for (unsigned k = 0; k < lanes; k++) {
        const unsigned other = exchanged ? 1u - k : k;
        const uint32_t mask = (1u << width) - 1u;
        int32_t a = (int32_t)(n >> (width * k) & mask), b = (int32_t)(m >> (width * other) & mask);
        if (!is_unsigned) {
            a = bytes ? (int8_t)(uint8_t)a : (int16_t)(uint16_t)a;
            b = bytes ? (int8_t)(uint8_t)b : (int16_t)(uint16_t)b;
        }
        /* ASX adds in the upper half, SAX in the lower one. */
        const bool difference = exchanged ? (k == 0u) == (op->x == 2u) : op->x >= 4u;
        bool ge;
        result |= lane(difference ? a - b : a + b, width, is_unsigned, prefix, difference, &ge) << (width * k);
        flags |= (ge ? (bytes ? 1u : 3u) : 0u) << (bytes ? k : 2u * k);
    }
    if (prefix == PLAIN) {
        s->ge = flags;
    }
    return result;
}

static uint32_t selected(const arm_state_t *s, uint32_t n, uint32_t m)
{
    uint32_t result = 0;
    for (unsigned k = 0; k < 4u; k++) {
        result |= ((s->ge >> k & 1u) != 0u ? n : m) & (0xFFu << (8u * k));
    }
    return result;
}

/* ---- products ------------------------------------------------------------------------------------------------------- */

/* Sum or difference of the products of the halves. */
static int64_t dual(uint32_t n, uint32_t m, const arm_op_t *op)
{
    m = turn(m, (op->x != 0u) ? 16u : 0u);
    const int64_t first = (int64_t)low(n) * low(m), second = (int64_t)high(n) * high(m);
    return (op->y != 0u) ? first - second : first + second;
}

/* A sum of 32 bits that wraps and sets Q. */
static uint32_t wrapped(arm_state_t *s, int64_t value)
{
    s->saturated |= (value != (int32_t)(uint32_t)value) ? 1u : 0u;
    return (uint32_t)value;
}

static uint32_t most_significant(const arm_state_t *s, const arm_op_t *op)
{
    const uint64_t product = (uint64_t)((int64_t)(int32_t)s->r[op->n] * (int32_t)s->r[op->m]);
    const uint64_t a = (op->z != 0u) ? (uint64_t)s->r[op->a] << 32 : 0u;
    const uint64_t sum = ((op->y != 0u) ? a - product : a + product) + ((op->x != 0u) ? 0x80000000u : 0u);
    return (uint32_t)(sum >> 32);
}

static uint32_t differences(uint32_t n, uint32_t m)
{
    uint32_t sum = 0;
    for (unsigned k = 0; k < 32u; k += 8u) {
        const uint32_t a = n >> k & 0xFFu, b = m >> k & 0xFFu;
        sum += (a > b) ? a - b : b - a;
    }
    return sum;
}

static void accumulate_long(arm_state_t *s, const arm_op_t *op, int64_t value)
{
    const uint64_t sum = ((uint64_t)s->r[op->d] << 32 | s->r[op->a]) + (uint64_t)value;
    s->r[op->a] = (uint32_t)sum;
    s->r[op->d] = (uint32_t)(sum >> 32);
}

/* ---- all ------------------------------------------------------------------------------------------------------------ */

static uint32_t saturated_halves(arm_state_t *s, uint32_t n, int64_t min, int64_t max)
{
    const int64_t upper = limited(high(n), min, max), lower = limited(low(n), min, max);
    s->saturated |= (upper != high(n) || lower != low(n)) ? 1u : 0u;
    return halves((int32_t)upper, (int32_t)lower);
}

static uint32_t extended_bytes(uint32_t n, uint32_t m, const arm_op_t *op, bool is_unsigned)
{
    const uint32_t value = turn(m, op->x);
    const uint32_t lower = is_unsigned ? value & 0xFFu : (uint32_t)(int32_t)(int8_t)(uint8_t)value;
    const uint32_t upper = is_unsigned ? value >> 16 & 0xFFu : (uint32_t)(int32_t)(int8_t)(uint8_t)(value >> 16);
    const uint32_t base = (op->z != 0u) ? n : 0u;
    return ((base >> 16) + upper) << 16 | ((base + lower) & 0xFFFFu);
}

void arm_dsp(arm_t *arm, const arm_op_t *op)
{
    arm_state_t *s = &arm->state;
    const uint32_t n = s->r[op->n], m = s->r[op->m];
    const int32_t a = (op->z != 0u) ? (int32_t)s->r[op->a] : 0;
    const uint32_t swapped = (m >> 8 & 0x00FF00FFu) | (m << 8 & 0xFF00FF00u);
    uint32_t result = 0;
    switch ((dsp_t)op->imm) {
    case DSP_REV:
        result = turn(swapped, 16u);
        break;
    case DSP_REV16:
        result = swapped;
        break;
    case DSP_REVSH:
        result = (uint32_t)low(swapped);
        break;
    case DSP_RBIT:
        result = reversed_bits(m);
        break;
    case DSP_SEL:
        result = selected(s, n, m);
        break;
    case DSP_QADD:
        result = (uint32_t)saturated(s, (int64_t)(int32_t)m + (int32_t)n);
        break;
    case DSP_QDADD:
        result = (uint32_t)saturated(s, (int64_t)(int32_t)m + saturated(s, 2 * (int64_t)(int32_t)n));
        break;
    case DSP_QSUB:
        result = (uint32_t)saturated(s, (int64_t)(int32_t)m - (int32_t)n);
        break;
    case DSP_QDSUB:
        result = (uint32_t)saturated(s, (int64_t)(int32_t)m - saturated(s, 2 * (int64_t)(int32_t)n));
        break;
    case DSP_PARALLEL:
        result = parallel(s, op);
        break;
    case DSP_SXTAB16:
        result = extended_bytes(n, m, op, false);
        break;
    case DSP_UXTAB16:
        result = extended_bytes(n, m, op, true);
        break;
    case DSP_PKHBT:
        result = (n & 0xFFFFu) | (m << op->x & 0xFFFF0000u);
        break;
    case DSP_PKHTB:
        result = (n & 0xFFFF0000u) | ((uint32_t)((int64_t)(int32_t)m >> op->x) & 0xFFFFu);
        break;
    case DSP_SSAT16:
        result = saturated_halves(s, n, -(INT64_C(1) << (op->z - 1u)), (INT64_C(1) << (op->z - 1u)) - 1);
        break;
    case DSP_USAT16:
        result = saturated_halves(s, n, 0, (INT64_C(1) << op->z) - 1);
        break;
    case DSP_SMLAD:
        result = wrapped(s, dual(n, m, op) + a);
        break;
    case DSP_SMLAW:
        result = wrapped(s, (((int64_t)(int32_t)n * low(m >> op->x)) >> 16) + a);
        break;
    case DSP_SMMLA:
        result = most_significant(s, op);
        break;
    case DSP_USADA8:
        result = differences(n, m) + (uint32_t)a;
        break;
    case DSP_SMLALXY:
        accumulate_long(s, op, (int64_t)low(n >> op->x) * low(m >> op->y));
        return;
    case DSP_SMLALD:
        accumulate_long(s, op, dual(n, m, op));
        return;
    case DSP_UMAAL: {
        const uint64_t sum = (uint64_t)n * m + s->r[op->d] + s->r[op->a];
        s->r[op->a] = (uint32_t)sum;
        result = (uint32_t)(sum >> 32);
        break;
    }
    }
    s->r[op->d] = result;
}

/* Instructions to operations. The encodings are those of the ARMv7-M Architecture Reference Manual, chapters A5 and A7. */
#include "arm/arm.h"
#include "arm/cycles.h"
#include "arm/operations.h"

#include <string.h>

/* What an instruction is decoded from. */
typedef struct {
    arm_t *arm;
    uint32_t address;
    uint32_t word; /* both half words, the first one above; a short instruction is in the upper half */
    bool in_it; /* conditional: short instructions set no flags */
} source_t;

static uint32_t bits(uint32_t word, unsigned first, unsigned count) { return (word >> first) & ((1u << count) - 1u); }

static uint32_t half_word(const arm_t *arm, uint32_t address)
{
    const arm_region_t *program = arm_program(arm, address);
    const uint32_t at = address - program->base;
    return (at + 1u < program->size) ? (uint32_t)program->bytes[at] | (uint32_t)program->bytes[at + 1u] << 8 : 0xDE00u;
}

static bool is_long(uint32_t first) { return first >> 11 >= 0x1Du; }

static arm_op_t operation(operation_t kind)
{
    return (arm_op_t){.kind = (uint16_t)kind, .cycles = CYCLES_PLAIN, .d = ARM_NOWHERE};
}

static arm_op_t undefined(void) { return operation(OP_UNDEFINED); }

static operation_t plus(operation_t kind, uint32_t more) { return (operation_t)((uint32_t)kind + more); }

/* ---- data processing ------------------------------------------------------------------------------------------------ */

#define FORM_STEP 2u /* a form has a kind without and one with flags */

static arm_op_t data(operation_t immediate_kind, bool flags, uint32_t d, uint32_t n)
{
    arm_op_t op = operation(plus(immediate_kind, flags ? 1u : 0u));
    op.d = (uint8_t)d;
    op.n = (uint8_t)n;
    return op;
}

static arm_op_t data_immediate(operation_t kind, bool flags, uint32_t d, uint32_t n, uint32_t imm)
{
    arm_op_t op = data(kind, flags, d, n);
    op.imm = imm;
    return op;
}

/* The second operand is register m, shifted. */
static arm_op_t data_register(operation_t kind, bool flags, uint32_t d, uint32_t n, uint32_t m, uint32_t type,
                              uint32_t amount)
{
    const bool plain = type == SHIFT_LSL && amount == 0u;
    arm_op_t op = data(plus(kind, FORM_STEP * (plain ? 1u : 2u + type)), flags, d, n);
    op.m = (uint8_t)m;
    op.x = (uint8_t)((amount == 0u && (type == SHIFT_LSR || type == SHIFT_ASR)) ? 32u : amount);
    return op;
}

static arm_op_t data_any(operation_t kind, bool flags, uint32_t d, uint32_t n, uint32_t m)
{
    return data_register(kind, flags, d, n, m, SHIFT_LSL, 0u);
}

static const operation_t data_kinds[16] = {
    [0] = OP_AND_IMM, [1] = OP_BIC_IMM,  [2] = OP_ORR_IMM,  [3] = OP_ORN_IMM,  [4] = OP_EOR_IMM,
    [8] = OP_ADD_IMM, [10] = OP_ADC_IMM, [11] = OP_SBC_IMM, [13] = OP_SUB_IMM, [14] = OP_RSB_IMM,
};

/* Kind of a long instruction, with MOV for ORR and MVN for ORN without a first operand; false: there is none. The destination of
 * a test is nowhere. */
static bool long_kind(uint32_t code, bool flags, uint32_t *d, uint32_t n, operation_t *kind)
{
    *kind = data_kinds[code];
    if (*kind == OP_DECODE) {
        return false;
    }
    const bool move = n == 15u && (code == 2u || code == 3u);
    const bool test = *d == 15u && flags && (code == 0u || code == 4u || code == 8u || code == 13u);
    if (move) {
        *kind = (code == 2u) ? OP_MOV_IMM : OP_MVN_IMM;
    }
    *d = test ? (uint32_t)ARM_NOWHERE : *d;
    return (test || *d < 15u) && (move || n < 15u);
}

static arm_op_t long_shifted(const source_t *from)
{
    const uint32_t word = from->word;
    const uint32_t code = bits(word, 21, 4), n = bits(word, 16, 4), m = bits(word, 0, 4);
    const uint32_t amount = bits(word, 12, 3) << 2 | bits(word, 6, 2), type = bits(word, 4, 2);
    const bool flags = bits(word, 20, 1) != 0u;
    uint32_t d = bits(word, 8, 4);
    if (code == 6u) { /* PKHBT, PKHTB */
        arm_op_t op = operation(OP_DSP);
        op.imm = (type & 2u) != 0u ? DSP_PKHTB : DSP_PKHBT;
        op.d = (uint8_t)d;
        op.n = (uint8_t)n;
        op.m = (uint8_t)m;
        op.x = (uint8_t)(((type & 2u) != 0u && amount == 0u) ? 32u : amount);
        return (d < 15u && n < 15u && m < 15u && (type & 1u) == 0u) ? op : undefined();
    }
    operation_t kind;
    if (!long_kind(code, flags, &d, n, &kind) || m == 15u) {
        return undefined();
    }
    return data_register(kind, flags, d, n, m, type, amount);
}

/* ThumbExpandImm_C; *carry: 2 if unchanged. */
static uint32_t expand(uint32_t code, uint32_t *carry)
{
    const uint32_t byte = code & 0xFFu;
    *carry = 2u;
    switch (code >> 8) {
    case 0:
        return byte;
    case 1:
        return byte << 16 | byte;
    case 2:
        return byte << 24 | byte << 8;
    case 3:
        return byte * 0x01010101u;
    default:
        break;
    }
    const uint32_t value = 0x80u | (code & 0x7Fu), turn = code >> 7;
    const uint32_t turned = value >> turn | value << (32u - turn);
    *carry = turned >> 31;
    return turned;
}

static arm_op_t long_immediate(const source_t *from)
{
    const uint32_t word = from->word;
    const uint32_t n = bits(word, 16, 4);
    const bool flags = bits(word, 20, 1) != 0u;
    uint32_t d = bits(word, 8, 4), carry;
    operation_t kind;
    if (!long_kind(bits(word, 21, 4), flags, &d, n, &kind)) {
        return undefined();
    }
    const uint32_t imm = expand(bits(word, 26, 1) << 11 | bits(word, 12, 3) << 8 | bits(word, 0, 8), &carry);
    arm_op_t op = data_immediate(kind, flags, d, n, imm);
    op.x = (uint8_t)carry;
    return op;
}

static arm_op_t saturation(uint32_t word, bool is_signed)
{
    const uint32_t amount = bits(word, 12, 3) << 2 | bits(word, 6, 2), right = bits(word, 21, 1);
    arm_op_t op = operation(is_signed ? OP_SSAT : OP_USAT);
    op.z = (uint8_t)(bits(word, 0, 5) + (is_signed ? 1u : 0u));
    if (right != 0u && amount == 0u) {
        op.kind = OP_DSP;
        op.imm = is_signed ? DSP_SSAT16 : DSP_USAT16;
    }
    op.x = (uint8_t)amount;
    op.y = (uint8_t)right;
    return op;
}

static arm_op_t long_plain_immediate(const source_t *from)
{
    const uint32_t word = from->word;
    const uint32_t n = bits(word, 16, 4), d = bits(word, 8, 4);
    const uint32_t imm12 = bits(word, 26, 1) << 11 | bits(word, 12, 3) << 8 | bits(word, 0, 8);
    const uint32_t imm16 = n << 12 | imm12, lsb = bits(word, 12, 3) << 2 | bits(word, 6, 2);
    const uint32_t here = (from->address + 4u) & ~3u;
    arm_op_t op = undefined();
    switch (bits(word, 20, 5)) {
    case 0x00:
        op = (n == 15u) ? data_immediate(OP_MOV_IMM, false, d, 0u, here + imm12)
                        : data_immediate(OP_ADD_IMM, false, d, n, imm12);
        break;
    case 0x04:
        op = data_immediate(OP_MOV_IMM, false, d, 0u, imm16);
        break;
    case 0x0A:
        op = (n == 15u) ? data_immediate(OP_MOV_IMM, false, d, 0u, here - imm12)
                        : data_immediate(OP_SUB_IMM, false, d, n, imm12);
        break;
    case 0x0C:
        op = operation(OP_MOVT);
        op.imm = imm16 << 16;
        break;
    case 0x10:
    case 0x12:
        op = saturation(word, true);
        break;
    case 0x18:
    case 0x1A:
        op = saturation(word, false);
        break;
    case 0x14:
    case 0x1C:
        op = operation((bits(word, 23, 1) != 0u) ? OP_UBFX : OP_SBFX);
        op.x = (uint8_t)lsb;
        op.z = (uint8_t)(bits(word, 0, 5) + 1u);
        if (lsb + op.z > 32u) {
            return undefined();
        }
        break;
    case 0x16: { /* BFI, BFC: bits imm of d from n << x */
        const uint32_t msb = bits(word, 0, 5);
        if (msb < lsb) {
            return undefined();
        }
        op = operation(OP_BFI);
        op.imm = (0xFFFFFFFFu >> (31u - (msb - lsb))) << lsb;
        op.x = (uint8_t)lsb;
        op.z = (uint8_t)((n == 15u) ? 0u : 1u);
        op.n = (uint8_t)((n == 15u) ? 0u : n);
        op.d = (uint8_t)d;
        return (d < 15u) ? op : undefined();
    }
    default:
        break;
    }
    op.d = (uint8_t)d;
    if (op.kind != OP_MOV_IMM && op.kind != OP_MOVT) {
        op.n = (uint8_t)n;
        return (d < 15u && n < 15u) ? op : undefined();
    }
    return (d < 15u) ? op : undefined();
}

/* ---- registers, products -------------------------------------------------------------------------------------------- */

static arm_op_t dsp(dsp_t which)
{
    arm_op_t op = operation(OP_DSP);
    op.imm = which;
    return op;
}

/* SXTH and its relatives. */
static arm_op_t extension(uint32_t code, uint32_t n, uint32_t turn)
{
    static const operation_t alone[6] = {OP_SXTH, OP_UXTH, OP_DSP, OP_DSP, OP_SXTB, OP_UXTB};
    static const operation_t added[6] = {OP_SXTAH, OP_UXTAH, OP_DSP, OP_DSP, OP_SXTAB, OP_UXTAB};
    if (code > 5u) {
        return undefined();
    }
    arm_op_t op = operation((n == 15u) ? alone[code] : added[code]);
    if (op.kind == OP_DSP) {
        op.imm = (code == 2u) ? DSP_SXTAB16 : DSP_UXTAB16;
        op.z = (uint8_t)((n == 15u) ? 0u : 1u);
    }
    op.x = (uint8_t)(8u * turn);
    return op;
}

static arm_op_t two_registers(uint32_t code, uint32_t second)
{
    static const uint8_t arithmetic[4] = {DSP_QADD, DSP_QDADD, DSP_QSUB, DSP_QDSUB};
    static const uint8_t reversal[4] = {DSP_REV, DSP_REV16, DSP_RBIT, DSP_REVSH};
    switch (code) {
    case 0:
        return dsp((dsp_t)arithmetic[second]);
    case 1:
        return dsp((dsp_t)reversal[second]);
    case 2:
        return (second == 0u) ? dsp(DSP_SEL) : undefined();
    case 3:
        return (second == 0u) ? operation(OP_CLZ) : undefined();
    default:
        return undefined();
    }
}

static arm_op_t long_registers(const source_t *from)
{
    const uint32_t word = from->word;
    const uint32_t code = bits(word, 20, 4), second = bits(word, 4, 4), n = bits(word, 16, 4);
    arm_op_t op = undefined();
    if (bits(word, 12, 4) != 15u) {
        return op;
    }
    if (code < 8u && second == 0u) {
        op = operation((code & 1u) != 0u ? OP_SHIFTS : OP_SHIFT);
        op.x = (uint8_t)(code >> 1);
    } else if (code < 8u && second >= 8u) {
        op = extension(code, n, second & 3u);
    } else if (code >= 8u && second < 8u && (second & 3u) != 3u) {
        op = dsp(DSP_PARALLEL);
        op.x = (uint8_t)(code & 7u);
        op.y = (uint8_t)second;
        if (op.x == 3u || op.x == 7u) {
            return undefined();
        }
    } else if (code >= 8u && second >= 8u && second < 12u) {
        op = two_registers(code & 7u, second & 3u);
    }
    op.d = (uint8_t)bits(word, 8, 4);
    op.n = (uint8_t)n;
    op.m = (uint8_t)bits(word, 0, 4);
    return (op.d < 15u && op.m < 15u) ? op : undefined();
}

static arm_op_t long_products(const source_t *from)
{
    const uint32_t word = from->word;
    const uint32_t second = bits(word, 4, 2), a = bits(word, 12, 4);
    const bool adds = a != 15u;
    arm_op_t op = undefined();
    switch (bits(word, 20, 3)) {
    case 0:
        if (second > 1u || (second == 1u && !adds)) {
            return op;
        }
        op = operation(!adds ? OP_MUL : (second == 0u) ? OP_MLA : OP_MLS);
        op.cycles = adds ? CYCLES_MULTIPLY_ADD : CYCLES_PLAIN;
        break;
    case 1:
        op = operation(adds ? OP_SMLAXY : OP_SMULXY);
        op.x = (uint8_t)(16u * (second >> 1));
        op.y = (uint8_t)(16u * (second & 1u));
        break;
    case 2:
    case 4:
        op = dsp(DSP_SMLAD);
        op.x = (uint8_t)(second & 1u);
        op.y = (bits(word, 20, 3) == 4u) ? 1u : 0u;
        op.z = adds ? 1u : 0u;
        break;
    case 3:
        op = dsp(DSP_SMLAW);
        op.x = (uint8_t)(16u * (second & 1u));
        op.z = adds ? 1u : 0u;
        break;
    case 5:
    case 6:
        op = dsp(DSP_SMMLA);
        op.x = (uint8_t)(second & 1u);
        op.y = (bits(word, 20, 3) == 6u) ? 1u : 0u;
        op.z = adds ? 1u : 0u;
        break;
    default:
        op = dsp(DSP_USADA8);
        op.z = adds ? 1u : 0u;
        break;
    }
    op.d = (uint8_t)bits(word, 8, 4);
    op.n = (uint8_t)bits(word, 16, 4);
    op.m = (uint8_t)bits(word, 0, 4);
    op.a = (uint8_t)a;
    return (op.d < 15u && op.n < 15u && op.m < 15u && bits(word, 6, 2) == 0u) ? op : undefined();
}

/* a: low word, d: high word. */
static arm_op_t long_wide_products(const source_t *from)
{
    const uint32_t word = from->word;
    const uint32_t code = bits(word, 20, 3), second = bits(word, 4, 4);
    arm_op_t op = undefined();
    if (second == 0u && (code & 1u) == 0u) {
        static const operation_t kinds[4] = {OP_SMULL, OP_UMULL, OP_SMLAL, OP_UMLAL};
        op = operation(kinds[code >> 1]);
    } else if (second == 15u && (code == 1u || code == 3u)) {
        op = operation((code == 1u) ? OP_SDIV : OP_UDIV);
        op.cycles = 0;
    } else if (code == 4u && second >= 8u && second < 12u) {
        op = dsp(DSP_SMLALXY);
        op.x = (uint8_t)(16u * bits(word, 5, 1));
        op.y = (uint8_t)(16u * bits(word, 4, 1));
    } else if ((code == 4u || code == 5u) && second >= 12u && second < 14u) {
        op = dsp(DSP_SMLALD);
        op.x = (uint8_t)(second & 1u);
        op.y = (code == 5u) ? 1u : 0u;
    } else if (code == 6u && second == 6u) {
        op = dsp(DSP_UMAAL);
    }
    op.d = (uint8_t)bits(word, 8, 4);
    op.n = (uint8_t)bits(word, 16, 4);
    op.m = (uint8_t)bits(word, 0, 4);
    op.a = (uint8_t)bits(word, 12, 4);
    const bool divides = op.kind == OP_SDIV || op.kind == OP_UDIV;
    return (op.d < 15u && op.n < 15u && op.m < 15u && (divides || (op.a < 15u && op.a != op.d))) ? op : undefined();
}

/* ---- loads and stores ----------------------------------------------------------------------------------------------- */

static bool loads(operation_t kind) { return kind < OP_STR_IMM; }

enum { OFFSET, INDEXED, BEFORE, AFTER }; /* ARM_ADDRESSING */

static arm_op_t transfer(operation_t kind, unsigned addressing, uint32_t t, uint32_t n)
{
    arm_op_t op = operation(plus(kind, addressing));
    op.d = (uint8_t)t;
    op.n = (uint8_t)n;
    op.cycles = loads(kind) ? CYCLES_LOAD : (addressing == INDEXED) ? CYCLES_STORE_INDEXED : CYCLES_STORE;
    if (t == 15u) {
        if (kind != OP_LDR_IMM) {
            return undefined();
        }
        op.kind = OP_LDR_PC;
        op.x = (uint8_t)addressing;
        op.cycles = CYCLES_LOAD + CYCLES_RELOAD;
    }
    return op;
}

static arm_op_t transfer_offset(operation_t kind, uint32_t t, uint32_t n, uint32_t offset)
{
    arm_op_t op = transfer(kind, OFFSET, t, n);
    op.imm = offset;
    return op;
}

static arm_op_t transfer_indexed(operation_t kind, uint32_t t, uint32_t n, uint32_t m, uint32_t shift)
{
    arm_op_t op = transfer(kind, INDEXED, t, n);
    op.m = (uint8_t)m;
    op.y = (uint8_t)shift;
    return (m < 15u && m != 13u) ? op : undefined();
}

/* The program does not change, so that a constant in it is an immediate operand, loaded. */
static arm_op_t load_literal(const source_t *from, operation_t kind, uint32_t t, uint32_t address)
{
    uint32_t value = half_word(from->arm, address);
    switch (kind) {
    case OP_LDR_IMM:
        value |= half_word(from->arm, address + 2u) << 16;
        break;
    case OP_LDRB_IMM:
        value &= 0xFFu;
        break;
    case OP_LDRSB_IMM:
        value = (uint32_t)(int32_t)(int8_t)(uint8_t)value;
        break;
    case OP_LDRSH_IMM:
        value = (uint32_t)(int32_t)(int16_t)(uint16_t)value;
        break;
    default:
        break;
    }
    arm_op_t op = data_immediate(OP_MOV_IMM, false, t, 0u, value);
    op.cycles = CYCLES_LOAD;
    if (t == 15u) { /* to another memory, which B does not reach */
        op = (kind == OP_LDR_IMM) ? operation(OP_BRANCH_TO) : undefined();
        op.imm = value;
        op.cycles = CYCLES_LOAD + CYCLES_RELOAD;
    }
    return op;
}

static arm_op_t long_transfer(const source_t *from)
{
    static const operation_t loading[8] = {OP_LDRB_IMM, OP_LDRH_IMM, OP_LDR_IMM, OP_DECODE, OP_LDRSB_IMM, OP_LDRSH_IMM};
    static const operation_t storing[8] = {OP_STRB_IMM, OP_STRH_IMM, OP_STR_IMM};
    const uint32_t word = from->word;
    const uint32_t size = bits(word, 21, 2) | bits(word, 24, 1) << 2, n = bits(word, 16, 4), t = bits(word, 12, 4);
    const bool load = bits(word, 20, 1) != 0u;
    const operation_t kind = load ? loading[size] : storing[size];
    if (kind == OP_DECODE) {
        return undefined();
    }
    if (n == 15u) {
        const uint32_t here = (from->address + 4u) & ~3u, offset = bits(word, 0, 12);
        return load ? load_literal(from, kind, t, (bits(word, 23, 1) != 0u) ? here + offset : here - offset)
                    : undefined();
    }
    if (bits(word, 23, 1) != 0u) {
        if (t == 15u && load && kind != OP_LDR_IMM) {
            return operation(OP_NOP); /* PLD, PLI */
        }
        return transfer_offset(kind, t, n, bits(word, 0, 12));
    }
    if (bits(word, 6, 6) == 0u) {
        return transfer_indexed(kind, t, n, bits(word, 0, 4), bits(word, 4, 2));
    }
    const bool before = bits(word, 10, 1) != 0u, back = bits(word, 8, 1) != 0u;
    if (bits(word, 11, 1) == 0u || (!before && !back) || (back && (n == t)) ||
        (before && !back && bits(word, 9, 1) != 0u)) {
        return undefined(); /* LDRT and STRT among others */
    }
    const uint32_t offset = (bits(word, 9, 1) != 0u) ? bits(word, 0, 8) : 0u - bits(word, 0, 8);
    arm_op_t op = transfer(kind, !back ? OFFSET : before ? BEFORE : AFTER, t, n);
    op.imm = offset;
    return op;
}

static uint32_t registers_in(uint32_t mask)
{
    uint32_t count = 0;
    for (; mask != 0u; mask &= mask - 1u) {
        count++;
    }
    return count;
}

/* x: the base is written back, y: the addresses end below the base, z: number of registers. */
static arm_op_t multiple(bool load, uint32_t n, uint32_t mask, bool back, bool below)
{
    arm_op_t op = operation(load ? OP_LDM : OP_STM);
    op.n = (uint8_t)n;
    op.imm = mask;
    op.x = back ? 1u : 0u;
    op.y = below ? 1u : 0u;
    op.z = (uint8_t)registers_in(mask);
    op.cycles = (uint8_t)(CYCLES_MULTIPLE(op.z) + ((mask >> 15 & 1u) != 0u ? CYCLES_RELOAD : 0u));
    const bool wrong = mask == 0u || n == 15u || (mask & 0x2000u) != 0u || (!load && (mask & 0x8000u) != 0u);
    return wrong ? undefined() : op;
}

static arm_op_t long_multiple(const source_t *from)
{
    const uint32_t word = from->word;
    const uint32_t direction = bits(word, 23, 2);
    const bool load = bits(word, 20, 1) != 0u, back = bits(word, 21, 1) != 0u;
    if ((direction != 1u && direction != 2u) || (back && (bits(word, 0, 16) >> bits(word, 16, 4) & 1u) != 0u)) {
        return undefined();
    }
    return multiple(load, bits(word, 16, 4), bits(word, 0, 16), back, direction == 2u);
}

static arm_op_t long_double(const source_t *from)
{
    const uint32_t word = from->word;
    const uint32_t n = bits(word, 16, 4);
    const bool before = bits(word, 24, 1) != 0u, up = bits(word, 23, 1) != 0u, back = bits(word, 21, 1) != 0u;
    if (!before && !back) {
        const uint32_t m = bits(word, 0, 4);
        if (bits(word, 20, 4) != 0xDu || bits(word, 5, 11) != 0x780u || m >= 15u) { /* exclusive access */
            return undefined();
        }
        arm_op_t op = operation((bits(word, 4, 1) != 0u) ? OP_TBH : OP_TBB);
        op.n = (uint8_t)n;
        op.m = (uint8_t)m;
        op.imm = from->address + 4u;
        op.cycles = CYCLES_TABLE_BRANCH + CYCLES_RELOAD;
        return op;
    }
    const bool load = bits(word, 20, 1) != 0u;
    arm_op_t op = operation(load ? OP_LDRD : OP_STRD);
    op.d = (uint8_t)bits(word, 12, 4);
    op.a = (uint8_t)bits(word, 8, 4);
    op.n = (uint8_t)n;
    op.imm = up ? bits(word, 0, 8) << 2 : 0u - (bits(word, 0, 8) << 2);
    op.x = back ? 1u : 0u;
    op.y = before ? 1u : 0u;
    op.cycles = CYCLES_MULTIPLE(2u);
    if (op.d >= 15u || op.a >= 15u) {
        return undefined();
    }
    if (n == 15u) { /* a constant of the program: the base is an address */
        op.n = ARM_NOWHERE;
        op.imm += (from->address + 4u) & ~3u;
        op.z = 1;
        return (load && !back) ? op : undefined();
    }
    return (back && (n == op.d || n == op.a)) ? undefined() : op;
}

/* ---- branches and control ------------------------------------------------------------------------------------------- */

/* imm is the distance in half words from this instruction. */
static arm_op_t branch(operation_t kind, const source_t *from, uint32_t target)
{
    arm_op_t op = operation(kind);
    const arm_region_t *program = arm_program(from->arm, from->address);
    op.imm = (uint32_t)((int32_t)(target - from->address) / 2);
    return (target - program->base < program->size) ? op : undefined();
}

static uint32_t sign_extended(uint32_t value, unsigned width)
{
    const uint32_t sign = 1u << (width - 1u);
    return (value ^ sign) - sign;
}

static arm_op_t control(uint32_t word)
{
    arm_op_t op = undefined();
    switch (bits(word, 20, 7)) {
    case 0x38: /* MSR */
        op = operation(OP_MSR);
        op.n = (uint8_t)bits(word, 16, 4);
        op.imm = bits(word, 0, 8);
        op.x = (uint8_t)bits(word, 10, 2);
        return (op.n < 15u && op.n != 13u) ? op : undefined();
    case 0x3A: /* hints */
        return (bits(word, 0, 8) == 3u) ? operation(OP_WFI) : (bits(word, 0, 11) < 5u) ? operation(OP_NOP) : op;
    case 0x3B: /* barriers */
        return (bits(word, 4, 4) >= 4u && bits(word, 4, 4) <= 6u) ? operation(OP_NOP) : op;
    case 0x3E: /* MRS */
        op = operation(OP_MRS);
        op.d = (uint8_t)bits(word, 8, 4);
        op.imm = bits(word, 0, 8);
        return (op.d < 15u && op.d != 13u) ? op : undefined();
    default:
        return op;
    }
}

static arm_op_t long_branch(const source_t *from)
{
    const uint32_t word = from->word;
    const uint32_t sign = bits(word, 26, 1), j1 = bits(word, 13, 1), j2 = bits(word, 11, 1), low = bits(word, 0, 11);
    const uint32_t next = from->address + 4u;
    if (bits(word, 12, 1) != 0u) {
        const uint32_t i1 = 1u ^ j1 ^ sign, i2 = 1u ^ j2 ^ sign;
        const uint32_t offset = sign << 24 | i1 << 23 | i2 << 22 | bits(word, 16, 10) << 12 | low << 1;
        return branch((bits(word, 14, 1) != 0u) ? OP_BL : OP_B, from, next + sign_extended(offset, 25));
    }
    if (bits(word, 14, 1) != 0u) {
        return undefined();
    }
    const uint32_t condition = bits(word, 22, 4);
    if (condition >= 14u) {
        return control(word);
    }
    const uint32_t offset = sign << 20 | j2 << 19 | j1 << 18 | bits(word, 16, 6) << 12 | low << 1;
    return branch(plus(OP_BEQ, condition), from, next + sign_extended(offset, 21));
}

static arm_op_t decode_long(const source_t *from)
{
    const uint32_t word = from->word;
    switch (bits(word, 27, 2)) {
    case 1:
        switch (bits(word, 25, 2)) {
        case 0:
            return (bits(word, 22, 1) != 0u) ? long_double(from) : long_multiple(from);
        case 1:
            return long_shifted(from);
        default:
            return undefined(); /* coprocessor, floating point */
        }
    case 2:
        return (bits(word, 15, 1) != 0u)   ? long_branch(from)
               : (bits(word, 25, 1) == 0u) ? long_immediate(from)
                                           : long_plain_immediate(from);
    default:
        break;
    }
    if (bits(word, 26, 1) != 0u) {
        return undefined();
    }
    if (bits(word, 25, 1) == 0u) {
        return (bits(word, 24, 1) != 0u && bits(word, 20, 1) == 0u) ? undefined() : long_transfer(from);
    }
    return (bits(word, 24, 1) == 0u)   ? long_registers(from)
           : (bits(word, 23, 1) == 0u) ? long_products(from)
                                       : long_wide_products(from);
}

/* ---- short instructions --------------------------------------------------------------------------------------------- */

static arm_op_t short_shift_add(const source_t *from, uint32_t half)
{
    const uint32_t d = bits(half, 0, 3), n = bits(half, 3, 3), third = bits(half, 6, 3);
    const bool flags = !from->in_it;
    switch (bits(half, 9, 5)) {
    case 12:
        return data_any(OP_ADD_IMM, flags, d, n, third);
    case 13:
        return data_any(OP_SUB_IMM, flags, d, n, third);
    case 14:
        return data_immediate(OP_ADD_IMM, flags, d, n, third);
    case 15:
        return data_immediate(OP_SUB_IMM, flags, d, n, third);
    default:
        return data_register(OP_MOV_IMM, flags, d, 0u, n, bits(half, 11, 2), bits(half, 6, 5));
    }
}

static arm_op_t short_immediate(const source_t *from, uint32_t half)
{
    const uint32_t d = bits(half, 8, 3), imm = bits(half, 0, 8);
    const bool flags = !from->in_it;
    arm_op_t op;
    switch (bits(half, 11, 2)) {
    case 0:
        op = data_immediate(OP_MOV_IMM, flags, d, 0u, imm);
        op.x = 2; /* the carry stays */
        return op;
    case 1:
        return data_immediate(OP_SUB_IMM, true, ARM_NOWHERE, d, imm);
    case 2:
        return data_immediate(OP_ADD_IMM, flags, d, d, imm);
    default:
        return data_immediate(OP_SUB_IMM, flags, d, d, imm);
    }
}

static arm_op_t shift_by_register(bool flags, uint32_t d, uint32_t m, uint32_t type)
{
    arm_op_t op = operation(flags ? OP_SHIFTS : OP_SHIFT);
    op.d = op.n = (uint8_t)d;
    op.m = (uint8_t)m;
    op.x = (uint8_t)type;
    return op;
}

static arm_op_t short_registers(const source_t *from, uint32_t half)
{
    const uint32_t d = bits(half, 0, 3), m = bits(half, 3, 3);
    const bool flags = !from->in_it;
    arm_op_t op;
    switch (bits(half, 6, 4)) {
    case 0:
        return data_any(OP_AND_IMM, flags, d, d, m);
    case 1:
        return data_any(OP_EOR_IMM, flags, d, d, m);
    case 2:
        return shift_by_register(flags, d, m, SHIFT_LSL);
    case 3:
        return shift_by_register(flags, d, m, SHIFT_LSR);
    case 4:
        return shift_by_register(flags, d, m, SHIFT_ASR);
    case 5:
        return data_any(OP_ADC_IMM, flags, d, d, m);
    case 6:
        return data_any(OP_SBC_IMM, flags, d, d, m);
    case 7:
        return shift_by_register(flags, d, m, SHIFT_ROR);
    case 8:
        return data_any(OP_AND_IMM, true, ARM_NOWHERE, d, m);
    case 9:
        return data_immediate(OP_RSB_IMM, flags, d, m, 0u);
    case 10:
        return data_any(OP_SUB_IMM, true, ARM_NOWHERE, d, m);
    case 11:
        return data_any(OP_ADD_IMM, true, ARM_NOWHERE, d, m);
    case 12:
        return data_any(OP_ORR_IMM, flags, d, d, m);
    case 13:
        op = operation(flags ? OP_MULS : OP_MUL);
        op.d = op.m = (uint8_t)d;
        op.n = (uint8_t)m;
        return op;
    case 14:
        return data_any(OP_BIC_IMM, flags, d, d, m);
    default:
        return data_any(OP_MVN_IMM, flags, d, 0u, m);
    }
}

static arm_op_t short_high(const source_t *from, uint32_t half)
{
    const uint32_t m = bits(half, 3, 4), d = bits(half, 0, 3) | bits(half, 7, 1) << 3;
    const uint32_t here = from->address + 4u;
    arm_op_t op;
    switch (bits(half, 8, 2)) {
    case 0:
        if (d == 15u) {
            return undefined();
        }
        return (m == 15u) ? data_immediate(OP_ADD_IMM, false, d, d, here) : data_any(OP_ADD_IMM, false, d, d, m);
    case 1:
        return (d == 15u || m == 15u) ? undefined() : data_any(OP_SUB_IMM, true, ARM_NOWHERE, d, m);
    case 2:
        if (d != 15u) {
            return (m == 15u) ? data_immediate(OP_MOV_IMM, false, d, 0u, here) : data_any(OP_MOV_IMM, false, d, 0u, m);
        }
        op = operation(OP_BX);
        op.x = 1; /* bit 0 of the address is ignored */
        break;
    default:
        op = operation(bits(half, 7, 1) != 0u ? OP_BLX : OP_BX);
        break;
    }
    op.m = (uint8_t)m;
    op.cycles = CYCLES_PLAIN + CYCLES_RELOAD;
    return (m == 15u) ? undefined() : op;
}

static arm_op_t short_misc(const source_t *from, uint32_t half)
{
    static const operation_t extends[4] = {OP_SXTH, OP_SXTB, OP_UXTH, OP_UXTB};
    static const dsp_t reverses[4] = {DSP_REV, DSP_REV16, DSP_REV, DSP_REVSH};
    arm_op_t op = undefined();
    switch (bits(half, 8, 4)) {
    case 0x0:
        return data_immediate((bits(half, 7, 1) != 0u) ? OP_SUB_IMM : OP_ADD_IMM, false, ARM_SP, ARM_SP,
                              bits(half, 0, 7) << 2);
    case 0x1:
    case 0x3:
    case 0x9:
    case 0xB:
        op = branch((bits(half, 11, 1) != 0u) ? OP_CBNZ : OP_CBZ, from,
                    from->address + 4u + (bits(half, 9, 1) << 6 | bits(half, 3, 5) << 1));
        op.n = (uint8_t)bits(half, 0, 3);
        return op;
    case 0x2:
        op = operation(extends[bits(half, 6, 2)]);
        op.d = (uint8_t)bits(half, 0, 3);
        op.m = (uint8_t)bits(half, 3, 3);
        return op;
    case 0x4:
    case 0x5:
        return multiple(false, ARM_SP, bits(half, 0, 8) | bits(half, 8, 1) << 14, true, true);
    case 0x6:
        if ((half & 0xFFECu) == 0xB660u) {
            op = operation(OP_CPS);
            op.x = (uint8_t)bits(half, 4, 1);
            op.y = (uint8_t)bits(half, 0, 2);
        }
        return op;
    case 0xA:
        if (bits(half, 6, 2) == 2u) {
            return op;
        }
        op = dsp(reverses[bits(half, 6, 2)]);
        op.d = (uint8_t)bits(half, 0, 3);
        op.m = (uint8_t)bits(half, 3, 3);
        return op;
    case 0xC:
    case 0xD:
        return multiple(true, ARM_SP, bits(half, 0, 8) | bits(half, 8, 1) << 15, true, false);
    case 0xE:
        op = operation(OP_BKPT);
        op.imm = bits(half, 0, 8);
        return op;
    case 0xF: /* hints; IT has been handled before */
        return (bits(half, 4, 4) == 3u) ? operation(OP_WFI) : (bits(half, 4, 4) < 5u) ? operation(OP_NOP) : op;
    default:
        return op;
    }
}

static arm_op_t short_transfer(uint32_t half)
{
    static const operation_t indexed[8] = {OP_STR_IMM, OP_STRH_IMM, OP_STRB_IMM, OP_LDRSB_IMM,
                                           OP_LDR_IMM, OP_LDRH_IMM, OP_LDRB_IMM, OP_LDRSH_IMM};
    const uint32_t t = bits(half, 0, 3), n = bits(half, 3, 3), imm5 = bits(half, 6, 5);
    const bool load = bits(half, 11, 1) != 0u;
    switch (bits(half, 12, 4)) {
    case 5:
        return transfer_indexed(indexed[bits(half, 9, 3)], t, n, bits(half, 6, 3), 0u);
    case 6:
        return transfer_offset(load ? OP_LDR_IMM : OP_STR_IMM, t, n, imm5 << 2);
    case 7:
        return transfer_offset(load ? OP_LDRB_IMM : OP_STRB_IMM, t, n, imm5);
    case 8:
        return transfer_offset(load ? OP_LDRH_IMM : OP_STRH_IMM, t, n, imm5 << 1);
    default:
        return transfer_offset(load ? OP_LDR_IMM : OP_STR_IMM, bits(half, 8, 3), ARM_SP, bits(half, 0, 8) << 2);
    }
}

static arm_op_t decode_short(const source_t *from)
{
    const uint32_t half = from->word >> 16;
    const uint32_t r = bits(half, 8, 3), imm8 = bits(half, 0, 8), here = (from->address + 4u) & ~3u;
    switch (half >> 12) {
    case 0x0:
    case 0x1:
        return short_shift_add(from, half);
    case 0x2:
    case 0x3:
        return short_immediate(from, half);
    case 0x4:
        return (bits(half, 11, 1) != 0u)   ? load_literal(from, OP_LDR_IMM, r, here + (imm8 << 2))
               : (bits(half, 10, 1) != 0u) ? short_high(from, half)
                                           : short_registers(from, half);
    case 0x5:
    case 0x6:
    case 0x7:
    case 0x8:
    case 0x9:
        return short_transfer(half);
    case 0xA:
        return (bits(half, 11, 1) != 0u) ? data_immediate(OP_ADD_IMM, false, r, ARM_SP, imm8 << 2)
                                         : data_immediate(OP_MOV_IMM, false, r, 0u, here + (imm8 << 2));
    case 0xB:
        return short_misc(from, half);
    case 0xC:
        return multiple(bits(half, 11, 1) != 0u, r, imm8, bits(half, 11, 1) == 0u || (imm8 >> r & 1u) == 0u, false);
    case 0xD:
        return (bits(half, 8, 4) >= 14u)
                   ? undefined()
                   : branch(plus(OP_BEQ, bits(half, 8, 4)), from, from->address + 4u + (sign_extended(imm8, 8) << 1));
    default:
        return branch(OP_B, from, from->address + 4u + (sign_extended(bits(half, 0, 11), 11) << 1));
    }
}

/* ---- one instruction ------------------------------------------------------------------------------------------------ */

static arm_op_t decode_one(const source_t *from)
{
    const bool wide = is_long(from->word >> 16);
    arm_op_t op = wide ? decode_long(from) : decode_short(from);
    op.length = wide ? 2u : 1u;
    return op;
}

static source_t source_at(arm_t *arm, uint32_t address, bool in_it)
{
    return (source_t){arm, address, half_word(arm, address) << 16 | half_word(arm, address + 2u), in_it};
}

static bool pipelined_load(const arm_op_t *op)
{
    return op->kind >= OP_LDR_IMM && op->kind < OP_STR_IMM && op->d < 15u;
}

/* A load, followed by a load or store whose address does not need the loaded register. */
static bool overlaps(arm_t *arm, uint32_t address, const arm_op_t *op)
{
    if (!pipelined_load(op)) {
        return false;
    }
    const source_t behind = source_at(arm, address + 2u * op->length, false);
    const arm_op_t next = decode_one(&behind);
    const bool moves = next.kind >= OP_LDR_IMM && next.kind <= OP_STRH_POST;
    const bool indexed = moves && (next.kind - OP_LDR_IMM) % 4u == INDEXED;
    return moves && next.n != op->d && !(indexed && next.m == op->d);
}

static uint32_t next_it(uint32_t it) { return ((it & 7u) == 0u) ? 0u : (it & 0xE0u) | (it << 1 & 0x1Fu); }

arm_op_t *arm_decode(arm_t *arm, uint32_t address, uint32_t it)
{
    arm_op_t *slot = arm_slot(arm, address);
    const source_t from = source_at(arm, address, it != 0u);
    const uint32_t half = from.word >> 16;
    if ((half & 0xFF00u) == 0xBF00u && (half & 0xFu) != 0u) {
        *slot = (it == 0u) ? operation(OP_NOP) : undefined();
        slot->length = 1;
        uint32_t at = address + 2u;
        for (uint32_t state = half & 0xFFu; state != 0u && arm_slot(arm, at) != NULL; state = next_it(state)) {
            at += 2u * arm_decode(arm, at, state)->length;
        }
        return slot;
    }
    arm_op_t op = decode_one(&from);
    op.cycles = (uint8_t)(op.cycles - (overlaps(arm, address, &op) ? 1u : 0u));
    op.it = (uint8_t)it;
    if (it >> 4 < 14u && it != 0u) {
        slot[arm->program_words] = op;
        *slot = operation(OP_CONDITIONAL);
        slot->x = (uint8_t)(it >> 4);
        slot->length = op.length;
        slot->it = (uint8_t)it;
    } else {
        *slot = op;
    }
    return slot;
}

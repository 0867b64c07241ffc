/* The loop that executes decoded instructions, and the accesses to memory. */
#include "arm/arm.h"
#include "arm/cycles.h"
#include "arm/operations.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "the memory of the program is in the byte order of the host, which must be little-endian"
#endif

#define SCS_BASE 0xE000E000u
#define SCS_SIZE 0x1000u

/* ---- errors --------------------------------------------------------------------------------------------------------- */

uint32_t arm_address(const arm_t *arm, const arm_op_t *op)
{
    const size_t at = (size_t)(op - arm->ops);
    return arm->region[0].base + 2u * (uint32_t)((at < arm->program_words) ? at : at - arm->program_words);
}

/* The instruction at an address as its half words, for messages. */
static void instruction_text(const arm_t *arm, uint32_t address, char *text, size_t size)
{
    const arm_region_t *program = &arm->region[0];
    const uint32_t at = address - program->base;
    unsigned half[2] = {0, 0};
    for (unsigned k = 0; k < 2u && at + 2u * k + 1u < program->size; k++) {
        half[k] = (unsigned)program->bytes[at + 2u * k] | (unsigned)program->bytes[at + 2u * k + 1u] << 8;
    }
    if (half[0] >> 11 >= 0x1Du) {
        (void)snprintf(text, size, "%04x %04x", half[0], half[1]);
    } else {
        (void)snprintf(text, size, "%04x", half[0]);
    }
}

void arm_fail(arm_t *arm, const char *format, ...)
{
    if (arm->failed) {
        return;
    }
    arm->failed = true;
    const uint32_t pc = (arm->op != NULL) ? arm_address(arm, arm->op) : arm->state.pc;
    char instruction[16], text[96];
    instruction_text(arm, pc, instruction, sizeof instruction);
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    (void)snprintf(arm->error, sizeof arm->error, "%s (instruction %s at pc %08lXh)", text, instruction,
                   (unsigned long)pc);
}

/* ---- memory --------------------------------------------------------------------------------------------------------- */

/* Place of an access in a region of memory, or NULL. */
static inline uint8_t *place(const arm_t *arm, uint32_t address, unsigned size, unsigned region)
{
    const arm_region_t *memory = &arm->region[region];
    const uint32_t at = address - memory->base;
    return (at < memory->size && memory->size - at >= size) ? memory->bytes + at : NULL;
}

static const uint8_t *find(const arm_t *arm, uint32_t address, unsigned size)
{
    for (unsigned k = 0; k < ARM_REGIONS; k++) {
        const uint8_t *found = place(arm, address, size, k);
        if (found != NULL) {
            return found;
        }
    }
    return NULL;
}

/* System control space: what is not modelled here is the owner's. */
static bool in_scs(uint32_t address, unsigned size) { return address - SCS_BASE < SCS_SIZE && size == 4u; }

NOINLINE uint32_t arm_load_slow(arm_t *arm, uint32_t address, unsigned size)
{
    uint32_t value = 0;
    const uint8_t *memory = find(arm, address, size);
    if (memory != NULL) {
        memcpy(&value, memory, size);
    } else if (address % size != 0u) {
        arm_fail(arm, "unaligned read of %u bytes at %08lXh", size, (unsigned long)address);
    } else if (!in_scs(address, size) || !arm_scs_read(arm, address, &value)) {
        if (!arm->owner->read(arm->self, address, size, &value)) {
            arm_fail(arm, "read of %u bytes at %08lXh, where nothing is", size, (unsigned long)address);
        }
    }
    return value;
}

NOINLINE void arm_store_slow(arm_t *arm, uint32_t address, unsigned size, uint32_t value)
{
    for (unsigned k = 0; k < ARM_REGIONS; k++) {
        uint8_t *memory = place(arm, address, size, k);
        if (memory != NULL && arm->region[k].writable) {
            memcpy(memory, &value, size);
            return;
        }
        if (memory != NULL) {
            arm_fail(arm, "write to the program at %08lXh", (unsigned long)address);
            return;
        }
    }
    if (address % size != 0u) {
        arm_fail(arm, "unaligned write of %u bytes at %08lXh", size, (unsigned long)address);
    } else if (!in_scs(address, size) || !arm_scs_write(arm, address, value)) {
        if (!arm->owner->write(arm->self, address, size, value)) {
            arm_fail(arm, "write of %u bytes at %08lXh, where nothing is", size, (unsigned long)address);
        }
    }
}

/* Region 1 is the RAM: most accesses. */
static inline uint32_t load(arm_t *arm, uint32_t address, unsigned size)
{
    uint32_t value = 0;
    const uint8_t *memory = place(arm, address, size, 1u);
    if (memory != NULL) {
        memcpy(&value, memory, size);
        return value;
    }
    return arm_load_slow(arm, address, size);
}

static inline void store(arm_t *arm, uint32_t address, unsigned size, uint32_t value)
{
    uint8_t *memory = place(arm, address, size, 1u);
    if (memory != NULL) {
        memcpy(memory, &value, size);
    } else {
        arm_store_slow(arm, address, size, value);
    }
}

/* ---- flags ---------------------------------------------------------------------------------------------------------- */

static inline void set_nz(arm_state_t *s, uint32_t result) { s->negative = s->nonzero = result; }

/* a + b + carry, with all flags. A subtraction adds the complement. */
static inline uint32_t add_flags(arm_state_t *s, uint32_t a, uint32_t b, uint32_t carry)
{
    const uint64_t wide = (uint64_t)a + b + carry;
    const uint32_t result = (uint32_t)wide;
    s->carry = (uint32_t)(wide >> 32);
    s->overflow = (a ^ result) & (b ^ result);
    set_nz(s, result);
    return result;
}

bool arm_condition(const arm_state_t *s, unsigned condition)
{
    const bool n = s->negative >> 31 != 0u, z = s->nonzero == 0u, c = s->carry != 0u, v = s->overflow >> 31 != 0u;
    bool holds = true;
    switch (condition >> 1) {
    case 0:
        holds = z;
        break;
    case 1:
        holds = c;
        break;
    case 2:
        holds = n;
        break;
    case 3:
        holds = v;
        break;
    case 4:
        holds = c && !z;
        break;
    case 5:
        holds = n == v;
        break;
    case 6:
        holds = n == v && !z;
        break;
    default:
        return true;
    }
    return holds != ((condition & 1u) != 0u);
}

/* ---- shifts by a register, saturation ------------------------------------------------------------------------------- */

/* The low eight bits of the amount count; *carry changes unless they are 0. */
static inline uint32_t shift(uint32_t value, unsigned type, uint32_t amount, uint32_t *carry)
{
    amount &= 0xFFu;
    if (amount == 0u) {
        return value;
    }
    switch (type) {
    case SHIFT_LSL:
        *carry = (amount <= 32u) ? value >> (32u - amount) & 1u : 0u;
        return (amount < 32u) ? value << amount : 0u;
    case SHIFT_LSR:
        *carry = (amount <= 32u) ? value >> (amount - 1u) & 1u : 0u;
        return (amount < 32u) ? value >> amount : 0u;
    case SHIFT_ASR:
        amount = (amount < 32u) ? amount : 32u;
        *carry = (uint32_t)((int64_t)(int32_t)value >> (amount - 1u)) & 1u;
        return (uint32_t)((int64_t)(int32_t)value >> amount);
    default:
        amount &= 31u;
        value = (amount == 0u) ? value : value >> amount | value << (32u - amount);
        *carry = value >> 31;
        return value;
    }
}

/* Saturation to a signed or unsigned range; sets Q. */
static inline uint32_t saturate(arm_state_t *s, int32_t value, int64_t min, int64_t max)
{
    const int64_t result = (value < min) ? min : (value > max) ? max : value;
    s->saturated |= (result != value) ? 1u : 0u;
    return (uint32_t)result;
}

static inline uint32_t sign_byte(uint32_t value) { return ((value & 0xFFu) ^ 0x80u) - 0x80u; }

static inline uint32_t sign_half(uint32_t value) { return ((value & 0xFFFFu) ^ 0x8000u) - 0x8000u; }

static inline int32_t product_halves(uint32_t n, uint32_t m) { return (int32_t)sign_half(n) * (int32_t)sign_half(m); }

static inline uint32_t turned(uint32_t value, unsigned amount)
{
    return (amount == 0u) ? value : value >> amount | value << (32u - amount);
}

/* ---- rare ones ------------------------------------------------------------------------------------------------------ */

static uint32_t leading_zeros(uint32_t value)
{
    uint32_t zeros = 0;
    for (uint32_t bit = 0x80000000u; bit != 0u && (value & bit) == 0u; bit >>= 1) {
        zeros++;
    }
    return zeros;
}

static uint32_t magnitude(uint32_t value) { return ((value >> 31) != 0u) ? 0u - value : value; }

/* The quotient, 0 for a divisor of 0, and its cycles. */
NOINLINE static uint32_t divide(arm_state_t *s, uint32_t n, uint32_t m, bool is_signed)
{
    const uint32_t a = is_signed ? magnitude(n) : n, b = is_signed ? magnitude(m) : m;
    const int32_t bits = (int32_t)leading_zeros(b) - (int32_t)leading_zeros(a) + 1;
    s->left -= (int32_t)cycles_divide((b == 0u || bits < 0) ? 0u : (uint32_t)bits);
    const uint32_t quotient = (b == 0u) ? 0u : a / b;
    return (is_signed && ((n ^ m) >> 31) != 0u) ? 0u - quotient : quotient;
}

NOINLINE static void move_from_special(arm_t *arm, const arm_op_t *op)
{
    arm_state_t *s = &arm->state;
    switch (op->imm) {
    case 0: /* APSR */
        s->r[op->d] = arm_xpsr(arm) & 0xF80F0000u;
        break;
    case 3: /* xPSR: execution bits read as 0 */
        s->r[op->d] = arm_xpsr(arm) & 0xF80F01FFu;
        break;
    case 5: /* IPSR */
        s->r[op->d] = s->exception;
        break;
    case 8: /* MSP */
        s->r[op->d] = s->r[ARM_SP];
        break;
    case 16:
        s->r[op->d] = s->primask;
        break;
    case 17:
    case 18:
        s->r[op->d] = s->basepri;
        break;
    case 19: /* FAULTMASK */
    case 20: /* CONTROL */
        s->r[op->d] = 0;
        break;
    default:
        arm_fail(arm, "special register %lu is not modelled", (unsigned long)op->imm);
        break;
    }
}

/* The core looks at its interrupts after this instruction. */
static void look_at_interrupts(arm_t *arm)
{
    arm->state.changed = 1;
    arm_end_run(arm);
}

NOINLINE static void move_to_special(arm_t *arm, const arm_op_t *op)
{
    arm_state_t *s = &arm->state;
    const uint32_t value = s->r[op->n];
    switch (op->imm) {
    case 0:
    case 3:
        if ((op->x & 2u) != 0u) {
            arm_set_flags(arm, (value & 0xF8000000u) | ((op->x & 1u) != 0u ? value & 0xF0000u : s->ge << 16));
        } else if ((op->x & 1u) != 0u) {
            s->ge = value >> 16 & 15u;
        }
        break;
    case 8:
        s->r[ARM_SP] = value & ~3u;
        break;
    case 16:
        s->primask = value & 1u;
        look_at_interrupts(arm);
        break;
    case 17:
        s->basepri = value & 0xF0u;
        look_at_interrupts(arm);
        break;
    default:
        if ((op->imm == 20u || op->imm == 19u) && (value & 7u) == 0u) {
            break;
        }
        arm_fail(arm, "special register %lu = %lXh is not modelled", (unsigned long)op->imm, (unsigned long)value);
        break;
    }
}

NOINLINE static void change_state(arm_t *arm, const arm_op_t *op)
{
    if ((op->y & 1u) != 0u) {
        arm_fail(arm, "FAULTMASK is not modelled");
        return;
    }
    arm->state.primask = op->x;
    look_at_interrupts(arm);
}

/* Loads of several registers; the value for the program counter, or 0. */
NOINLINE static uint32_t load_multiple(arm_t *arm, const arm_op_t *op)
{
    arm_state_t *s = &arm->state;
    const uint32_t base = s->r[op->n] - (op->y != 0u ? 4u * op->z : 0u);
    uint32_t value[16] = {0}, at = base;
    if ((base & 3u) != 0u) {
        arm_fail(arm, "unaligned read of several words at %08lXh", (unsigned long)base);
        return 0;
    }
    for (unsigned k = 0; k < 16u; k++) {
        if ((op->imm >> k & 1u) != 0u) {
            value[k] = load(arm, at, 4u);
            at += 4u;
            if (arm->failed) {
                return 0;
            }
        }
    }
    if (op->x != 0u) {
        s->r[op->n] = (op->y != 0u) ? base : at;
    }
    for (unsigned k = 0; k < 15u; k++) {
        s->r[k] = ((op->imm >> k & 1u) != 0u) ? value[k] : s->r[k];
    }
    return value[15];
}

NOINLINE static void store_multiple(arm_t *arm, const arm_op_t *op)
{
    arm_state_t *s = &arm->state;
    const uint32_t base = s->r[op->n] - (op->y != 0u ? 4u * op->z : 0u);
    uint32_t at = base;
    if ((base & 3u) != 0u) {
        arm_fail(arm, "unaligned write of several words at %08lXh", (unsigned long)base);
        return;
    }
    for (unsigned k = 0; k < 15u && !arm->failed; k++) {
        if ((op->imm >> k & 1u) != 0u) {
            store(arm, at, 4u, s->r[k]);
            at += 4u;
        }
    }
    if (op->x != 0u && !arm->failed) {
        s->r[op->n] = (op->y != 0u) ? base : at;
    }
}

NOINLINE static void transfer_double(arm_t *arm, const arm_op_t *op, bool loads)
{
    arm_state_t *s = &arm->state;
    const uint32_t base = (op->z != 0u) ? 0u : s->r[op->n];
    const uint32_t moved = base + op->imm;
    const uint32_t address = (op->y != 0u) ? moved : base;
    if ((address & 3u) != 0u) {
        arm_fail(arm, "unaligned access of two words at %08lXh", (unsigned long)address);
        return;
    }
    if (loads) {
        const uint32_t first = load(arm, address, 4u), second = load(arm, address + 4u, 4u);
        s->r[op->d] = first;
        s->r[op->a] = second;
    } else {
        store(arm, address, 4u, s->r[op->d]);
        store(arm, address + 4u, 4u, s->r[op->a]);
    }
    if (op->x != 0u) {
        s->r[op->n] = moved;
    }
}

NOINLINE static uint32_t load_counter(arm_t *arm, const arm_op_t *op)
{
    arm_state_t *s = &arm->state;
    const uint32_t base = s->r[op->n];
    const uint32_t moved = base + ((op->x == 1u) ? s->r[op->m] << op->y : op->imm);
    const uint32_t value = load(arm, (op->x == 3u) ? base : moved, 4u);
    if (op->x >= 2u) {
        s->r[op->n] = moved;
    }
    return value;
}

/* ---- branches ------------------------------------------------------------------------------------------------------- */

/* The operation at the program counter. Within an IT block it is decoded with the others of the block, unless the state has been
 * restored: then it is decoded here. */
static const arm_op_t *operation_at(arm_t *arm)
{
    const arm_op_t *op = &arm->ops[(arm->state.pc - arm->region[0].base) / 2u];
    return (op->kind == OP_DECODE && arm->state.it != 0u) ? arm_decode(arm, arm->state.pc, arm->state.it) : op;
}

NOINLINE const arm_op_t *arm_branch(arm_t *arm, uint32_t target)
{
    const uint32_t at = (target & ~1u) - arm->region[0].base;
    if (at < arm->region[0].size && (target & 1u) != 0u) {
        return &arm->ops[at / 2u];
    }
    if (arm->state.exception != 0u && target >= 0xFFFFFFE0u) {
        arm_exception_return(arm, target);
        look_at_interrupts(arm);
        return arm->failed ? NULL : operation_at(arm);
    }
    if ((target & ~1u) == ARM_CALL_RETURN) {
        return NULL;
    }
    arm_fail(arm, "branch to %08lXh, where no program is", (unsigned long)target);
    return NULL;
}

/* ---- the loop ------------------------------------------------------------------------------------------------------- */

#define R(name) s->r[op->name]
#define NEXT                                                                                                           \
    op += op->length;                                                                                                  \
    break

/* Second operands, and their carry (x of an immediate is 2 if the carry stays). */
#define VALUE_IMM (op->imm)
#define VALUE_REG (R(m))
#define VALUE_LSL (R(m) << op->x)
#define VALUE_LSR ((uint32_t)((uint64_t)R(m) >> op->x))
#define VALUE_ASR ((uint32_t)((int64_t)(int32_t)R(m) >> op->x))
#define VALUE_ROX ((op->x == 0u) ? s->carry << 31 | R(m) >> 1 : R(m) >> op->x | R(m) << (32u - op->x))
#define CARRY_IMM ((op->x == 2u) ? s->carry : op->x)
#define CARRY_REG (s->carry)
#define CARRY_LSL (R(m) >> (32u - op->x) & 1u)
#define CARRY_LSR ((uint32_t)((uint64_t)R(m) >> (op->x - 1u)) & 1u)
#define CARRY_ASR ((uint32_t)((int64_t)(int32_t)R(m) >> (op->x - 1u)) & 1u)
#define CARRY_ROX ((op->x == 0u) ? R(m) & 1u : R(m) >> (op->x - 1u) & 1u)

#define LOGICAL(name, form, expression)                                                                                \
    case OP_##name##_##form: {                                                                                         \
        const uint32_t a = R(n), b = VALUE_##form;                                                                     \
        (void)a;                                                                                                       \
        R(d) = (expression);                                                                                           \
        NEXT;                                                                                                          \
    }                                                                                                                  \
    case OP_##name##S_##form: {                                                                                        \
        const uint32_t a = R(n), b = VALUE_##form, carry = CARRY_##form, result = (expression);                        \
        (void)a;                                                                                                       \
        s->carry = carry;                                                                                              \
        set_nz(s, result);                                                                                             \
        R(d) = result;                                                                                                 \
        NEXT;                                                                                                          \
    }

#define ARITHMETIC(name, form, first, second, with)                                                                    \
    case OP_##name##_##form: {                                                                                         \
        const uint32_t a = R(n), b = VALUE_##form;                                                                     \
        R(d) = (first) + (second) + (with);                                                                            \
        NEXT;                                                                                                          \
    }                                                                                                                  \
    case OP_##name##S_##form: {                                                                                        \
        const uint32_t a = R(n), b = VALUE_##form;                                                                     \
        R(d) = add_flags(s, (first), (second), (with));                                                                \
        NEXT;                                                                                                          \
    }

#define EVERY_FORM(DO, name, ...)                                                                                      \
    DO(name, IMM, __VA_ARGS__)                                                                                         \
    DO(name, REG, __VA_ARGS__)                                                                                         \
    DO(name, LSL, __VA_ARGS__)                                                                                         \
    DO(name, LSR, __VA_ARGS__)                                                                                         \
    DO(name, ASR, __VA_ARGS__)                                                                                         \
    DO(name, ROX, __VA_ARGS__)

#define TRANSFER(name, DO)                                                                                             \
    case OP_##name##_IMM: {                                                                                            \
        const uint32_t address = R(n) + op->imm;                                                                       \
        DO;                                                                                                            \
        NEXT_TRANSFER;                                                                                                 \
    }                                                                                                                  \
    case OP_##name##_REG: {                                                                                            \
        const uint32_t address = R(n) + (R(m) << op->y);                                                               \
        DO;                                                                                                            \
        NEXT_TRANSFER;                                                                                                 \
    }                                                                                                                  \
    case OP_##name##_PRE: {                                                                                            \
        const uint32_t address = R(n) + op->imm;                                                                       \
        DO;                                                                                                            \
        R(n) = address;                                                                                                \
        NEXT_TRANSFER;                                                                                                 \
    }                                                                                                                  \
    case OP_##name##_POST: {                                                                                           \
        const uint32_t address = R(n);                                                                                 \
        DO;                                                                                                            \
        R(n) = address + op->imm;                                                                                      \
        NEXT_TRANSFER;                                                                                                 \
    }

#define NEXT_TRANSFER                                                                                                  \
    if (arm->failed) {                                                                                                 \
        goto failed;                                                                                                   \
    }                                                                                                                  \
    NEXT

#define BRANCH_IF(name, condition)                                                                                     \
    case OP_B##name:                                                                                                   \
        if (condition) {                                                                                               \
            s->left -= (int32_t)CYCLES_RELOAD;                                                                         \
            op += (int32_t)op->imm;                                                                                    \
            break;                                                                                                     \
        }                                                                                                              \
        NEXT;

#define FLAG_N (s->negative >> 31 != 0u)
#define FLAG_Z (s->nonzero == 0u)
#define FLAG_C (s->carry != 0u)
#define FLAG_V (s->overflow >> 31 != 0u)
#define SAME_NV (((s->negative ^ s->overflow) >> 31) == 0u)

arm_stop_t arm_run(arm_t *arm)
{
    arm_state_t *const s = &arm->state;
    const arm_op_t *op = operation_at(arm);
    arm_stop_t stop = ARM_TIME;
    uint64_t instructions = 0;
    if (arm->failed) {
        return ARM_FAILED;
    }
    while (s->left > 0) {
        arm->op = op;
        instructions++;
        s->left -= (int32_t)op->cycles;
    again:
        switch ((operation_t)op->kind) {
        case OP_DECODE:
            instructions--;
            (void)arm_decode(arm, arm_address(arm, op), 0u);
            break;
            EVERY_FORM(LOGICAL, AND, a & b)
            EVERY_FORM(LOGICAL, BIC, a & ~b)
            EVERY_FORM(LOGICAL, ORR, a | b)
            EVERY_FORM(LOGICAL, ORN, a | ~b)
            EVERY_FORM(LOGICAL, EOR, a ^ b)
            EVERY_FORM(LOGICAL, MOV, b)
            EVERY_FORM(LOGICAL, MVN, ~b)
            EVERY_FORM(ARITHMETIC, ADD, a, b, 0u)
            EVERY_FORM(ARITHMETIC, ADC, a, b, s->carry)
            EVERY_FORM(ARITHMETIC, SBC, a, ~b, s->carry)
            EVERY_FORM(ARITHMETIC, SUB, a, ~b, 1u)
            EVERY_FORM(ARITHMETIC, RSB, ~a, b, 1u)
            TRANSFER(LDR, R(d) = load(arm, address, 4u))
            TRANSFER(LDRB, R(d) = load(arm, address, 1u))
            TRANSFER(LDRH, R(d) = load(arm, address, 2u))
            TRANSFER(LDRSB, R(d) = sign_byte(load(arm, address, 1u)))
            TRANSFER(LDRSH, R(d) = sign_half(load(arm, address, 2u)))
            TRANSFER(STR, store(arm, address, 4u, R(d)))
            TRANSFER(STRB, store(arm, address, 1u, R(d) & 0xFFu))
            TRANSFER(STRH, store(arm, address, 2u, R(d) & 0xFFFFu))
        case OP_SHIFT: {
            uint32_t carry = 0;
            R(d) = shift(R(n), op->x, R(m), &carry);
            NEXT;
        }
        case OP_SHIFTS: {
            const uint32_t result = shift(R(n), op->x, R(m), &s->carry);
            set_nz(s, result);
            R(d) = result;
            NEXT;
        }
        case OP_MOVT:
            R(d) = (R(d) & 0xFFFFu) | op->imm;
            NEXT;
        case OP_MUL:
            R(d) = R(n) * R(m);
            NEXT;
        case OP_MULS: {
            const uint32_t result = R(n) * R(m);
            set_nz(s, result);
            R(d) = result;
            NEXT;
        }
        case OP_MLA:
            R(d) = R(a) + R(n) * R(m);
            NEXT;
        case OP_MLS:
            R(d) = R(a) - R(n) * R(m);
            NEXT;
        case OP_SMULL: {
            const int64_t product = (int64_t)(int32_t)R(n) * (int32_t)R(m);
            R(a) = (uint32_t)product;
            R(d) = (uint32_t)((uint64_t)product >> 32);
            NEXT;
        }
        case OP_UMULL: {
            const uint64_t product = (uint64_t)R(n) * R(m);
            R(a) = (uint32_t)product;
            R(d) = (uint32_t)(product >> 32);
            NEXT;
        }
        case OP_SMLAL: {
            const uint64_t sum = ((uint64_t)R(d) << 32 | R(a)) + (uint64_t)((int64_t)(int32_t)R(n) * (int32_t)R(m));
            R(a) = (uint32_t)sum;
            R(d) = (uint32_t)(sum >> 32);
            NEXT;
        }
        case OP_UMLAL: {
            const uint64_t sum = ((uint64_t)R(d) << 32 | R(a)) + (uint64_t)R(n) * R(m);
            R(a) = (uint32_t)sum;
            R(d) = (uint32_t)(sum >> 32);
            NEXT;
        }
        case OP_SDIV:
            R(d) = divide(s, R(n), R(m), true);
            NEXT;
        case OP_UDIV:
            R(d) = divide(s, R(n), R(m), false);
            NEXT;
        case OP_SMULXY:
            R(d) = (uint32_t)product_halves(R(n) >> op->x, R(m) >> op->y);
            NEXT;
        case OP_SMLAXY: {
            const int64_t sum = (int64_t)product_halves(R(n) >> op->x, R(m) >> op->y) + (int32_t)R(a);
            s->saturated |= (sum != (int32_t)sum) ? 1u : 0u;
            R(d) = (uint32_t)sum;
            NEXT;
        }
        case OP_SSAT: {
            const int32_t value = (op->y != 0u) ? (int32_t)R(n) >> op->x : (int32_t)(R(n) << op->x);
            const int64_t limit = INT64_C(1) << (op->z - 1u);
            R(d) = saturate(s, value, -limit, limit - 1);
            NEXT;
        }
        case OP_USAT: {
            const int32_t value = (op->y != 0u) ? (int32_t)R(n) >> op->x : (int32_t)(R(n) << op->x);
            R(d) = saturate(s, value, 0, (INT64_C(1) << op->z) - 1);
            NEXT;
        }
        case OP_SBFX:
            R(d) = (uint32_t)((int32_t)(R(n) << (32u - op->z - op->x)) >> (32u - op->z));
            NEXT;
        case OP_UBFX:
            R(d) = (R(n) << (32u - op->z - op->x)) >> (32u - op->z);
            NEXT;
        case OP_BFI:
            R(d) = (R(d) & ~op->imm) | ((op->z != 0u) ? R(n) << op->x & op->imm : 0u);
            NEXT;
        case OP_SXTB:
            R(d) = sign_byte(turned(R(m), op->x));
            NEXT;
        case OP_SXTH:
            R(d) = sign_half(turned(R(m), op->x));
            NEXT;
        case OP_UXTB:
            R(d) = turned(R(m), op->x) & 0xFFu;
            NEXT;
        case OP_UXTH:
            R(d) = turned(R(m), op->x) & 0xFFFFu;
            NEXT;
        case OP_SXTAB:
            R(d) = R(n) + sign_byte(turned(R(m), op->x));
            NEXT;
        case OP_SXTAH:
            R(d) = R(n) + sign_half(turned(R(m), op->x));
            NEXT;
        case OP_UXTAB:
            R(d) = R(n) + (turned(R(m), op->x) & 0xFFu);
            NEXT;
        case OP_UXTAH:
            R(d) = R(n) + (turned(R(m), op->x) & 0xFFFFu);
            NEXT;
        case OP_CLZ:
            R(d) = leading_zeros(R(m));
            NEXT;
        case OP_DSP:
            arm_dsp(arm, op);
            NEXT;
        case OP_LDRD:
            transfer_double(arm, op, true);
            NEXT_TRANSFER;
        case OP_STRD:
            transfer_double(arm, op, false);
            NEXT_TRANSFER;
        case OP_LDM: {
            const uint32_t target = load_multiple(arm, op);
            if (arm->failed) {
                goto failed;
            }
            if (op->imm >> 15 != 0u) {
                op = arm_branch(arm, target);
                goto branched;
            }
            NEXT;
        }
        case OP_STM:
            store_multiple(arm, op);
            NEXT_TRANSFER;
        case OP_LDR_PC: {
            const uint32_t target = load_counter(arm, op);
            if (arm->failed) {
                goto failed;
            }
            op = arm_branch(arm, target);
            goto branched;
        }
        case OP_TBB:
        case OP_TBH: {
            const bool halves = op->kind == OP_TBH;
            const uint32_t base = (op->n == 15u) ? op->imm : R(n);
            const uint32_t offset = halves ? load(arm, base + (R(m) << 1), 2u) : load(arm, base + R(m), 1u);
            if (arm->failed) {
                goto failed;
            }
            op = arm_branch(arm, (op->imm + 2u * offset) | 1u);
            goto branched;
        }
        case OP_B:
            s->left -= (int32_t)CYCLES_RELOAD;
            op += (int32_t)op->imm;
            break;
            BRANCH_IF(EQ, FLAG_Z)
            BRANCH_IF(NE, !FLAG_Z)
            BRANCH_IF(CS, FLAG_C)
            BRANCH_IF(CC, !FLAG_C)
            BRANCH_IF(MI, FLAG_N)
            BRANCH_IF(PL, !FLAG_N)
            BRANCH_IF(VS, FLAG_V)
            BRANCH_IF(VC, !FLAG_V)
            BRANCH_IF(HI, FLAG_C && !FLAG_Z)
            BRANCH_IF(LS, !FLAG_C || FLAG_Z)
            BRANCH_IF(GE, SAME_NV)
            BRANCH_IF(LT, !SAME_NV)
            BRANCH_IF(GT, SAME_NV && !FLAG_Z)
            BRANCH_IF(LE, !SAME_NV || FLAG_Z)
        case OP_BL:
            s->left -= (int32_t)CYCLES_RELOAD;
            s->r[ARM_LR] = (arm_address(arm, op) + 4u) | 1u;
            op += (int32_t)op->imm;
            break;
        case OP_BX:
            op = arm_branch(arm, R(m) | op->x);
            goto branched;
        case OP_BLX: {
            const uint32_t target = R(m);
            s->r[ARM_LR] = (arm_address(arm, op) + 2u) | 1u;
            op = arm_branch(arm, target);
            goto branched;
        }
        case OP_CBZ:
            if (R(n) == 0u) {
                s->left -= (int32_t)CYCLES_RELOAD;
                op += (int32_t)op->imm;
                break;
            }
            NEXT;
        case OP_CBNZ:
            if (R(n) != 0u) {
                s->left -= (int32_t)CYCLES_RELOAD;
                op += (int32_t)op->imm;
                break;
            }
            NEXT;
        case OP_CONDITIONAL:
            if (arm_condition(s, op->x)) {
                op += arm->program_words;
                s->left -= (int32_t)op->cycles - 1;
                goto again;
            }
            NEXT;
        case OP_NOP:
            NEXT;
        case OP_WFI:
            op += op->length;
            s->sleeping = 1;
            s->changed = 1; /* an interrupt may be pending already */
            stop = ARM_SLEEPING;
            goto leave;
        case OP_CPS:
            change_state(arm, op);
            NEXT_TRANSFER;
        case OP_MRS:
            move_from_special(arm, op);
            NEXT_TRANSFER;
        case OP_MSR:
            move_to_special(arm, op);
            NEXT_TRANSFER;
        case OP_BKPT:
            if (!arm->owner->breakpoint(arm->self, op->imm)) {
                arm_fail(arm, "breakpoint %lu", (unsigned long)op->imm);
            }
            NEXT_TRANSFER;
        case OP_UNDEFINED:
            arm_fail(arm, "undefined instruction, or one that is not modelled");
            goto failed;
        }
        /* A conditional instruction has its operation in the second half of the table. */
        if (op >= arm->ops + arm->program_words) {
            op -= arm->program_words;
        }
        continue;
    branched:
        if (op == NULL) {
            stop = arm->failed ? ARM_FAILED : ARM_RETURNED;
            op = arm->op;
            break;
        }
    }
leave:
    s->instructions += instructions;
    s->pc = arm_address(arm, op);
    s->it = op->it;
    arm->op = NULL;
    return stop;
failed:
    op = arm->op;
    stop = ARM_FAILED;
    goto leave;
}

#define BEYOND 2u /* half words behind the program, which decode as undefined: it does not end by itself */

/* ---- life ----------------------------------------------------------------------------------------------------------- */

bool arm_init(arm_t *arm, const arm_region_t *regions, unsigned count, const arm_owner_t *owner, void *self)
{
    memset(arm, 0, sizeof *arm);
    memcpy(arm->region, regions, count * sizeof *regions);
    arm->program_words = regions[0].size / 2u + BEYOND;
    arm->owner = owner;
    arm->self = self;
    arm->ops = (arm_op_t *)calloc(2u * (size_t)arm->program_words, sizeof *arm->ops);
    return arm->ops != NULL;
}

void arm_free(arm_t *arm)
{
    free(arm->ops);
    arm->ops = NULL;
}

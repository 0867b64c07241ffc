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
    const size_t place = (size_t)(op - arm->ops);
    const uint32_t at = (uint32_t)((place < arm->program_words) ? place : place - arm->program_words);
    return (at < arm->first_words) ? arm->region[0].base + 2u * at
                                   : arm->region[arm->other].base + 2u * (at - arm->first_words);
}

arm_op_t *arm_slot(const arm_t *arm, uint32_t address)
{
    uint32_t at = address - arm->region[0].base;
    if (at < arm->region[0].size) {
        return &arm->ops[at / 2u];
    }
    at = address - arm->region[arm->other].base;
    return (arm->other != 0u && at < arm->region[arm->other].size) ? &arm->ops[arm->first_words + at / 2u] : NULL;
}

const arm_region_t *arm_program(const arm_t *arm, uint32_t address)
{
    return &arm->region[(address - arm->region[0].base < arm->region[0].size) ? 0u : arm->other];
}

const arm_region_t *arm_running_in(const arm_t *arm) { return arm_program(arm, arm_address(arm, arm->op)); }

void arm_forget(arm_t *arm)
{
    if (arm->region[0].writable) {
        memset(arm->ops, 0, arm->first_words * sizeof *arm->ops);
        memset(arm->ops + arm->program_words, 0, arm->first_words * sizeof *arm->ops);
    }
}

uint32_t arm_begun(const arm_t *arm) { return arm_elapsed(arm) - arm->op->cycles; }

/* The instruction at an address as its half words, for messages. */
static void instruction_text(const arm_t *arm, uint32_t address, char *text, size_t size)
{
    const arm_region_t *program = arm_program(arm, address);
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
        if (found != NULL && !arm->region[k].slow) {
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
            const arm_op_t *slot = (k == 0u) ? arm_slot(arm, address) : NULL;
            if (slot != NULL && slot->kind != OP_DECODE) {
                arm_fail(arm, "write to an instruction at %08lXh that has been executed", (unsigned long)address);
            }
            memcpy(memory, &value, size);
            return;
        }
        if (memory != NULL) { /* by commands of a flash */
            if (!arm->owner->write(arm->self, address, size, value)) {
                arm_fail(arm, "write to the program at %08lXh", (unsigned long)address);
            }
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

/* The RAM, region 1, is where most accesses go. Its last three bytes take the way of all others, so that one comparison is enough. */
#define RAM_PLACE(address) (((address) - ram_base <= ram_last) ? ram + ((address) - ram_base) : NULL)
#define RAM_OF(arm)                                                                                                    \
    uint8_t *const ram = (arm)->region[1].bytes;                                                                       \
    const uint32_t ram_base = (arm)->region[1].base, ram_last = (arm)->region[1].size - 4u

static inline uint32_t load(arm_t *arm, uint32_t address, unsigned size)
{
    RAM_OF(arm);
    const uint8_t *memory = RAM_PLACE(address);
    uint32_t value = 0;
    if (memory != NULL) {
        memcpy(&value, memory, size);
        return value;
    }
    return arm_load_slow(arm, address, size);
}

static inline void store(arm_t *arm, uint32_t address, unsigned size, uint32_t value)
{
    RAM_OF(arm);
    uint8_t *memory = RAM_PLACE(address);
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

static inline uint32_t leading_zeros(uint32_t value)
{
#if defined(__GNUC__)
    return (value != 0u) ? (uint32_t)__builtin_clz(value) : 32u;
#else
    uint32_t zeros = 0;
    for (uint32_t bit = 0x80000000u; bit != 0u && (value & bit) == 0u; bit >>= 1) {
        zeros++;
    }
    return zeros;
#endif
}

/* Number of the lowest bit that is set; the word is not 0. */
static inline uint32_t lowest_bit(uint32_t word) { return 31u - leading_zeros(word & (0u - word)); }

static uint32_t magnitude(uint32_t value) { return ((value >> 31) != 0u) ? 0u - value : value; }

/* The quotient, 0 for a divisor of 0; its cycles are taken from `left`. */
static inline uint32_t divide(int32_t *left, uint32_t n, uint32_t m, bool is_signed)
{
    const uint32_t a = is_signed ? magnitude(n) : n, b = is_signed ? magnitude(m) : m;
    const int32_t bits = (int32_t)leading_zeros(b) - (int32_t)leading_zeros(a) + 1;
    *left -= (int32_t)cycles_divide((b == 0u || bits < 0) ? 0u : (uint32_t)bits);
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
    uint32_t value[16], at = base;
    value[15] = 0;
    if ((base & 3u) != 0u) {
        arm_fail(arm, "unaligned read of several words at %08lXh", (unsigned long)base);
        return 0;
    }
    for (uint32_t rest = op->imm; rest != 0u; rest &= rest - 1u) {
        value[lowest_bit(rest)] = load(arm, at, 4u);
        at += 4u;
        if (arm->failed) {
            return 0;
        }
    }
    if (op->x != 0u) {
        s->r[op->n] = (op->y != 0u) ? base : at;
    }
    for (uint32_t rest = op->imm & 0x7FFFu; rest != 0u; rest &= rest - 1u) {
        s->r[lowest_bit(rest)] = value[lowest_bit(rest)];
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
    for (uint32_t rest = op->imm; rest != 0u && !arm->failed; rest &= rest - 1u) {
        store(arm, at, 4u, s->r[lowest_bit(rest)]);
        at += 4u;
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
    const arm_op_t *op = arm_slot(arm, arm->state.pc);
    return (op->kind == OP_DECODE && arm->state.it != 0u) ? arm_decode(arm, arm->state.pc, arm->state.it) : op;
}

/* A branch to where no program is. NULL: the run ends. */
NOINLINE static const arm_op_t *leave_program(arm_t *arm, uint32_t target)
{
    if (arm->state.exception != 0u && target >= 0xFFFFFFE0u) {
        arm_exception_return(arm, target);
        look_at_interrupts(arm);
        return arm->failed ? NULL : operation_at(arm);
    }
    if ((target & ~1u) == ARM_CALL_RETURN) {
        return NULL;
    }
    if ((target & 1u) != 0u && arm_slot(arm, target & ~1u) != NULL) {
        return arm_slot(arm, target & ~1u); /* in the other region */
    }
    arm_fail(arm, "branch to %08lXh, where no program is", (unsigned long)target);
    return NULL;
}

/* ---- the loop ------------------------------------------------------------------------------------------------------- */

#define R(name) s->r[in->name]
#define NEXT                                                                                                           \
    op += op->length;                                                                                                  \
    break

/* Second operands, and their carry (x of an immediate is 2 if the carry stays). */
#define VALUE_IMM (in->imm)
#define VALUE_REG (R(m))
#define VALUE_LSL (R(m) << in->x)
#define VALUE_LSR ((uint32_t)((uint64_t)R(m) >> in->x))
#define VALUE_ASR ((uint32_t)((int64_t)(int32_t)R(m) >> in->x))
#define VALUE_ROX ((in->x == 0u) ? s->carry << 31 | R(m) >> 1 : R(m) >> in->x | R(m) << (32u - in->x))
#define CARRY_IMM ((in->x == 2u) ? s->carry : in->x)
#define CARRY_REG (s->carry)
#define CARRY_LSL (R(m) >> (32u - in->x) & 1u)
#define CARRY_LSR ((uint32_t)((uint64_t)R(m) >> (in->x - 1u)) & 1u)
#define CARRY_ASR ((uint32_t)((int64_t)(int32_t)R(m) >> (in->x - 1u)) & 1u)
#define CARRY_ROX ((in->x == 0u) ? R(m) & 1u : R(m) >> (in->x - 1u) & 1u)

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
        const uint32_t address = R(n) + in->imm;                                                                       \
        DO;                                                                                                            \
        NEXT;                                                                                                          \
    }                                                                                                                  \
    case OP_##name##_REG: {                                                                                            \
        const uint32_t address = R(n) + (R(m) << in->y);                                                               \
        DO;                                                                                                            \
        NEXT;                                                                                                          \
    }                                                                                                                  \
    case OP_##name##_PRE: {                                                                                            \
        const uint32_t address = R(n) + in->imm;                                                                       \
        DO;                                                                                                            \
        R(n) = address;                                                                                                \
        NEXT;                                                                                                          \
    }                                                                                                                  \
    case OP_##name##_POST: {                                                                                           \
        const uint32_t address = R(n);                                                                                 \
        DO;                                                                                                            \
        R(n) = address + in->imm;                                                                                      \
        NEXT;                                                                                                          \
    }

/* What may fail, end the run or take cycles of its own sees the state of the loop. */
#define LEAVE_LOOP                                                                                                     \
    arm->op = in;                                                                                                      \
    s->left = left
#define BACK_IN_LOOP                                                                                                   \
    left = s->left;                                                                                                    \
    if (arm->failed) {                                                                                                 \
        goto failed;                                                                                                   \
    }
#define RARE(operation)                                                                                                \
    LEAVE_LOOP;                                                                                                        \
    operation;                                                                                                         \
    BACK_IN_LOOP

/* `value` of `size` bytes at `address`. */
#define LOAD(size)                                                                                                     \
    uint32_t value = 0;                                                                                                \
    const uint8_t *memory = RAM_PLACE(address);                                                                        \
    if (memory != NULL) {                                                                                              \
        memcpy(&value, memory, size);                                                                                  \
    } else {                                                                                                           \
        RARE(value = arm_load_slow(arm, address, size));                                                               \
    }
#define STORE(size, what)                                                                                              \
    const uint32_t value = (what);                                                                                     \
    uint8_t *memory = RAM_PLACE(address);                                                                              \
    if (memory != NULL) {                                                                                              \
        memcpy(memory, &value, size);                                                                                  \
    } else {                                                                                                           \
        RARE(arm_store_slow(arm, address, size, value));                                                               \
    }

/* To an address of the program; or the return from an exception, or the end of a call. */
#define BRANCH(address)                                                                                                \
    const uint32_t to = (address), place_of = (to & ~1u) - program_base;                                               \
    if (place_of < program_size && (to & 1u) != 0u) {                                                                  \
        op = &ops[place_of / 2u];                                                                                      \
        break;                                                                                                         \
    }                                                                                                                  \
    const arm_op_t *const before = op;                                                                                 \
    LEAVE_LOOP;                                                                                                        \
    op = leave_program(arm, to);                                                                                       \
    left = s->left;                                                                                                    \
    if (op == NULL) {                                                                                                  \
        op = before;                                                                                                   \
        stop = arm->failed ? ARM_FAILED : ARM_RETURNED;                                                                \
        goto leave;                                                                                                    \
    }                                                                                                                  \
    break

#define BRANCH_IF(name, condition)                                                                                     \
    case OP_B##name:                                                                                                   \
        if (condition) {                                                                                               \
            left -= (int32_t)CYCLES_RELOAD;                                                                            \
            op += (int32_t)in->imm;                                                                                    \
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
    int32_t left = s->left;
    const uint32_t program_base = arm->region[0].base, program_size = arm->region[0].size;
    const uint32_t program_words = arm->program_words;
    const arm_op_t *const ops = arm->ops;
    RAM_OF(arm);
    if (arm->failed) {
        return ARM_FAILED;
    }
    while (left > 0) {
        const arm_op_t *in = op; /* or, of a conditional one, in the second half of the table */
        instructions++;
        left -= (int32_t)in->cycles;
    again:
        switch ((operation_t)in->kind) {
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
            TRANSFER(LDR, LOAD(4u) R(d) = value)
            TRANSFER(LDRB, LOAD(1u) R(d) = value)
            TRANSFER(LDRH, LOAD(2u) R(d) = value)
            TRANSFER(LDRSB, LOAD(1u) R(d) = sign_byte(value))
            TRANSFER(LDRSH, LOAD(2u) R(d) = sign_half(value))
            TRANSFER(STR, STORE(4u, R(d)))
            TRANSFER(STRB, STORE(1u, R(d) & 0xFFu))
            TRANSFER(STRH, STORE(2u, R(d) & 0xFFFFu))
        case OP_SHIFT: {
            uint32_t carry = 0;
            R(d) = shift(R(n), in->x, R(m), &carry);
            NEXT;
        }
        case OP_SHIFTS: {
            const uint32_t result = shift(R(n), in->x, R(m), &s->carry);
            set_nz(s, result);
            R(d) = result;
            NEXT;
        }
        case OP_MOVT:
            R(d) = (R(d) & 0xFFFFu) | in->imm;
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
            R(d) = divide(&left, R(n), R(m), true);
            NEXT;
        case OP_UDIV:
            R(d) = divide(&left, R(n), R(m), false);
            NEXT;
        case OP_SMULXY:
            R(d) = (uint32_t)product_halves(R(n) >> in->x, R(m) >> in->y);
            NEXT;
        case OP_SMLAXY: {
            const int64_t sum = (int64_t)product_halves(R(n) >> in->x, R(m) >> in->y) + (int32_t)R(a);
            s->saturated |= (sum != (int32_t)sum) ? 1u : 0u;
            R(d) = (uint32_t)sum;
            NEXT;
        }
        case OP_SSAT: {
            const int32_t value = (in->y != 0u) ? (int32_t)R(n) >> in->x : (int32_t)(R(n) << in->x);
            const int64_t limit = INT64_C(1) << (in->z - 1u);
            R(d) = saturate(s, value, -limit, limit - 1);
            NEXT;
        }
        case OP_USAT: {
            const int32_t value = (in->y != 0u) ? (int32_t)R(n) >> in->x : (int32_t)(R(n) << in->x);
            R(d) = saturate(s, value, 0, (INT64_C(1) << in->z) - 1);
            NEXT;
        }
        case OP_SBFX:
            R(d) = (uint32_t)((int32_t)(R(n) << (32u - in->z - in->x)) >> (32u - in->z));
            NEXT;
        case OP_UBFX:
            R(d) = (R(n) << (32u - in->z - in->x)) >> (32u - in->z);
            NEXT;
        case OP_BFI:
            R(d) = (R(d) & ~in->imm) | ((in->z != 0u) ? R(n) << in->x & in->imm : 0u);
            NEXT;
        case OP_SXTB:
            R(d) = sign_byte(turned(R(m), in->x));
            NEXT;
        case OP_SXTH:
            R(d) = sign_half(turned(R(m), in->x));
            NEXT;
        case OP_UXTB:
            R(d) = turned(R(m), in->x) & 0xFFu;
            NEXT;
        case OP_UXTH:
            R(d) = turned(R(m), in->x) & 0xFFFFu;
            NEXT;
        case OP_SXTAB:
            R(d) = R(n) + sign_byte(turned(R(m), in->x));
            NEXT;
        case OP_SXTAH:
            R(d) = R(n) + sign_half(turned(R(m), in->x));
            NEXT;
        case OP_UXTAB:
            R(d) = R(n) + (turned(R(m), in->x) & 0xFFu);
            NEXT;
        case OP_UXTAH:
            R(d) = R(n) + (turned(R(m), in->x) & 0xFFFFu);
            NEXT;
        case OP_CLZ:
            R(d) = leading_zeros(R(m));
            NEXT;
        case OP_DSP:
            arm_dsp(arm, in);
            NEXT;
        case OP_LDRD:
            RARE(transfer_double(arm, in, true));
            NEXT;
        case OP_STRD:
            RARE(transfer_double(arm, in, false));
            NEXT;
        case OP_LDM: {
            uint32_t target;
            RARE(target = load_multiple(arm, in));
            if (in->imm >> 15 != 0u) {
                BRANCH(target);
            }
            NEXT;
        }
        case OP_STM:
            RARE(store_multiple(arm, in));
            NEXT;
        case OP_BRANCH_TO: {
            BRANCH(in->imm);
        }
        case OP_LDR_PC: {
            uint32_t target;
            RARE(target = load_counter(arm, in));
            BRANCH(target);
        }
        case OP_TBB:
        case OP_TBH: {
            const bool halves = in->kind == OP_TBH;
            const uint32_t base = (in->n == 15u) ? in->imm : R(n);
            uint32_t offset;
            RARE(offset = halves ? load(arm, base + (R(m) << 1), 2u) : load(arm, base + R(m), 1u));
            BRANCH((in->imm + 2u * offset) | 1u);
        }
        case OP_B:
            left -= (int32_t)CYCLES_RELOAD;
            op += (int32_t)in->imm;
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
            left -= (int32_t)CYCLES_RELOAD;
            s->r[ARM_LR] = (arm_address(arm, op) + 4u) | 1u;
            op += (int32_t)in->imm;
            break;
        case OP_BX: {
            BRANCH(R(m) | in->x);
        }
        case OP_BLX: {
            const uint32_t target = R(m);
            s->r[ARM_LR] = (arm_address(arm, op) + 2u) | 1u;
            BRANCH(target);
        }
        case OP_CBZ:
            if (R(n) == 0u) {
                left -= (int32_t)CYCLES_RELOAD;
                op += (int32_t)in->imm;
                break;
            }
            NEXT;
        case OP_CBNZ:
            if (R(n) != 0u) {
                left -= (int32_t)CYCLES_RELOAD;
                op += (int32_t)in->imm;
                break;
            }
            NEXT;
        case OP_CONDITIONAL:
            if (arm_condition(s, in->x)) {
                in += program_words;
                left -= (int32_t)in->cycles - 1;
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
            RARE(change_state(arm, in));
            NEXT;
        case OP_MRS:
            RARE(move_from_special(arm, in));
            NEXT;
        case OP_MSR:
            RARE(move_to_special(arm, in));
            NEXT;
        case OP_BKPT:
            RARE(if (!arm->owner->breakpoint(arm->self, in->imm)) {
                arm_fail(arm, "breakpoint %lu", (unsigned long)in->imm);
            });
            NEXT;
        case OP_UNDEFINED:
            RARE(arm_fail(arm, "undefined instruction, or one that is not modelled"));
            break;
        }
    }
leave:
    s->left = left;
    s->instructions += instructions;
    s->pc = arm_address(arm, op);
    s->it = op->it;
    arm->op = NULL;
    return stop;
failed:
    stop = ARM_FAILED;
    goto leave;
}

#define BEYOND 2u /* half words behind the program, which decode as undefined: it does not end by itself */

/* ---- life ----------------------------------------------------------------------------------------------------------- */

bool arm_init(arm_t *arm, const arm_region_t *regions, unsigned count, const arm_owner_t *owner, void *self)
{
    memset(arm, 0, sizeof *arm);
    memcpy(arm->region, regions, count * sizeof *regions);
    arm->first_words = arm->program_words = regions[0].size / 2u + BEYOND;
    arm->boot = regions[0].base;
    for (unsigned k = 1; k < count; k++) {
        if (regions[k].executable) {
            arm->other = k;
            arm->program_words = arm->first_words + regions[k].size / 2u + BEYOND;
        }
    }
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

/* Runs instructions with many operands and prints a hash of the results of each case: the referee of servo_twin/native/arm.
 *
 * A case is generated (arm_cases.py): code that ends with BX LR, a mask of registers that are addresses in the scratch memory and
 * one of registers that are small offsets. Its results are r0..r12, the flags and the scratch memory.
 */
#include <stdint.h>

#include "machine.h"

#define REGISTERS 13u
#define FLAGS 13u
#define WORDS 14u
#define ROUNDS 12u
#define SCRATCH_WORDS 64u
#define SCRATCH_MIDDLE 128u /* bytes */

typedef struct {
    uint32_t code;
    uint32_t addresses, offsets; /* masks */
} case_t;

extern const case_t cases[];
extern const uint32_t cases_count;

static uint32_t scratch[SCRATCH_WORDS];

/* Call `code` with r0..r12 and the flags from `in`, and store them to `out`. */
__attribute__((naked, noinline)) static void run_case(uint32_t code, const uint32_t *in, uint32_t *out)
{
    (void)code;
    (void)in;
    (void)out;
    __asm__ volatile("push {r4-r11, lr}\n\t"
                     "push {r0, r2}\n\t"
                     "ldr r3, [r1, #52]\n\t"
                     "msr APSR_nzcvqg, r3\n\t"
                     "ldr lr, =1f + 1\n\t"
                     "ldmia.w r1, {r0-r12}\n\t"
                     "ldr.w pc, [sp]\n\t"
                     "1:\n\t"
                     "push {r0-r12}\n\t"
                     "mrs r1, APSR\n\t"
                     "ldr r0, [sp, #56]\n\t"
                     "str r1, [r0, #52]\n\t"
                     "pop {r1-r7}\n\t"
                     "stmia r0!, {r1-r7}\n\t"
                     "pop {r1-r6}\n\t"
                     "stmia r0!, {r1-r6}\n\t"
                     "pop {r0, r2}\n\t"
                     "pop {r4-r11, pc}\n\t"
                     ".ltorg\n\t");
}

static uint32_t next(uint32_t *state)
{
    uint32_t x = *state;
    x ^= x << 13;
    x ^= x >> 17;
    x ^= x << 5;
    *state = x;
    return x;
}

/* Random, small, or at the limits of 8, 16 and 32 bits. */
static uint32_t operand(uint32_t *state)
{
    static const uint32_t limits[] = {0,          1,          2,          31,         32,         33,
                                      0x7F,       0x80,       0xFF,       0x100,      0x7FFF,     0x8000,
                                      0xFFFF,     0x10000,    0x7FFF8000, 0x80007FFF, 0x7FFFFFFF, 0x80000000,
                                      0x80000001, 0xFFFF8000, 0xFFFFFFFE, 0xFFFFFFFF};
    const uint32_t kind = next(state) >> 16 & 7u, value = next(state);
    return (kind < 3u)    ? limits[value % (sizeof limits / sizeof limits[0])]
           : (kind == 3u) ? value >> 24
           : (kind == 4u) ? value >> (value & 31u)
                          : value;
}

static uint32_t hash(uint32_t sum, const uint32_t *word, uint32_t count)
{
    for (uint32_t k = 0; k < count; k++) {
        sum = (sum ^ word[k]) * 0x01000193u;
        sum ^= sum >> 15;
    }
    return sum;
}

int main(void)
{
    uint32_t state = 0x2545F491u;
    machine_start();
    for (uint32_t n = 0; n < cases_count; n++) {
        uint32_t sum = 0x811C9DC5u;
        for (uint32_t round = 0; round < ROUNDS; round++) {
            uint32_t in[WORDS], out[WORDS];
            for (uint32_t k = 0; k < SCRATCH_WORDS; k++) {
                scratch[k] = operand(&state);
            }
            for (uint32_t k = 0; k < REGISTERS; k++) {
                const uint32_t value = operand(&state);
                in[k] = ((cases[n].addresses >> k & 1u) != 0u)
                            ? (uint32_t)(uintptr_t)scratch + SCRATCH_MIDDLE + (value & 12u)
                        : ((cases[n].offsets >> k & 1u) != 0u) ? value & 7u
                                                               : value;
            }
            in[FLAGS] = next(&state) & 0xF80F0000u;
            if ((in[FLAGS] >> 30) == 3u) {
                in[FLAGS] &= 0xBFFFFFFFu;
            }
            run_case(cases[n].code, in, out);
            sum = hash(hash(sum, out, WORDS), scratch, SCRATCH_WORDS);
        }
        machine_print_hex(sum);
    }
    machine_stop(0);
}

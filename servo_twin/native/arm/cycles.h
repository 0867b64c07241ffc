/* cycles.h - cycles of the instructions of a Cortex-M4 without wait states (Arm, Cortex-M4 Technical Reference Manual, instruction
 * set summary and load/store timings).
 *
 * Where the manual gives a range: a taken branch reloads the pipeline in two cycles, of 1 to 3; a division takes its 2 to 12 in
 * proportion to the bits of the quotient. An IT instruction is never folded.
 */
#ifndef ARM_CYCLES_H
#define ARM_CYCLES_H

#include <stdint.h>

#define CYCLES_PLAIN 1u
#define CYCLES_RELOAD 2u /* in addition, of any write to the program counter */
#define CYCLES_MULTIPLY_ADD 2u /* MLA, MLS; all other products take one */
#define CYCLES_LOAD 2u /* one, if a load or store follows whose address does not need the loaded register */
#define CYCLES_STORE 1u /* with an immediate offset */
#define CYCLES_STORE_INDEXED 2u
#define CYCLES_MULTIPLE(registers) (1u + (registers)) /* LDM, STM, PUSH, POP, LDRD, STRD */
#define CYCLES_TABLE_BRANCH 2u
#define CYCLES_ENTRY 12u /* of an exception, the frame stored */
#define CYCLES_RETURN 10u
#define CYCLES_TAIL_CHAIN 6u
#define CYCLES_DIVIDE_MIN 2u
#define CYCLES_DIVIDE_MAX 12u

/* Of a division whose quotient has at most `bits` significant bits (0..32). */
static inline uint32_t cycles_divide(uint32_t bits)
{
    return CYCLES_DIVIDE_MIN + (bits * (CYCLES_DIVIDE_MAX - CYCLES_DIVIDE_MIN) + 31u) / 32u;
}

#endif

/* program_table.h - PROGRAM_TABLE: constant table in program memory, used in place of `const`. Interrupts may read
 * it while the data flash is being written. Some processors cannot address it with a data pointer: read it with
 * program_table_copy(). */
#ifndef SERVO_MATH_PROGRAM_TABLE_H
#define SERVO_MATH_PROGRAM_TABLE_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__AVR__)
#include <avr/pgmspace.h>
#define PROGRAM_TABLE const PROGMEM
static inline void program_table_copy(void *to, const void *from, size_t size) { (void)memcpy_P(to, from, size); }
#elif defined(__MWERKS__)
#define PROGRAM_TABLE const __pmem
static inline void program_table_copy(void *to, const __pmem void *from, size_t size)
{
    const __pmem uint16_t *word = (const __pmem uint16_t *)from; /* P memory has words only */
    for (size_t i = 0; i < size / sizeof *word; i++) {
        ((uint16_t *)to)[i] = word[i];
    }
}
#else
#define PROGRAM_TABLE const
static inline void program_table_copy(void *to, const void *from, size_t size) { (void)memcpy(to, from, size); }
#endif

#endif

/* cell.h - access to memory of any type in cells of 4, 2 or 1 bytes.
 *
 * A cell is read and written by one instruction where the processor has one, so that no interrupt divides the access.
 * The AVR, a target of tests without interrupts, has none for 4 and 2 bytes.
 */
#ifndef COMM_CELL_H
#define COMM_CELL_H

#include <stdint.h>

#ifdef __GNUC__
typedef uint16_t __attribute__((may_alias)) cell2_t;
typedef uint32_t __attribute__((may_alias)) cell4_t;
#else /* compilers without type-based alias analysis */
typedef uint16_t cell2_t;
typedef uint32_t cell4_t;
#endif

/* Largest cell (4, 2 or 1 bytes) into which `size` bytes at `offset` of an aligned memory can be divided. */
static inline uint8_t cell_of(uint32_t offset, uint32_t size)
{
    const uint32_t odd = offset | size;
    return (odd & 3u) == 0 ? 4 : (odd & 1u) == 0 ? 2 : 1;
}

#endif

/* cost_loops.c - counts the loops within the interrupts. The linker inserts these functions
 * (-Wl,--wrap=axis_fast,--wrap=axis_slow); the interrupts then cost more than without them. */
#include "cost.h"
#include "drive/axis.h"
#include "machine.h"

void __real_axis_fast(axis_t *axis);
void __real_axis_slow(axis_t *axis);
void __wrap_axis_fast(axis_t *axis);
void __wrap_axis_slow(axis_t *axis);

void __wrap_axis_fast(axis_t *axis)
{
    const uint32_t begin = machine_clock();
    __real_axis_fast(axis);
    cost_add(COST_FAST, machine_instructions(begin, machine_clock()));
}

void __wrap_axis_slow(axis_t *axis)
{
    const uint32_t begin = machine_clock();
    __real_axis_slow(axis);
    cost_add(COST_SLOW, machine_instructions(begin, machine_clock()));
}

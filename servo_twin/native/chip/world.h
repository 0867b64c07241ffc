/* world.h - what the chip's pins are soldered to, and the software that its core runs.
 *
 * The chip calls these functions and includes nothing of plant and firmware. The program that links the chip defines them, the
 * board or a test; `world` is what it has given to chip_init.
 */
#ifndef CHIP_WORLD_H
#define CHIP_WORLD_H

#include <stdint.h>

#define CHIP_NEVER UINT64_MAX /* clock of what is not going to happen */

/* Come along to `clock` (never back). */
void world_advance(void *world, uint64_t clock);

/* Clock of the next event of the world's own, CHIP_NEVER if there is none; asked for before each event of the chip. */
uint64_t world_next(void *world);

/* That clock has come: hand over what happened by chip_pin. */
void world_events(void *world);

/* What chip_deferrable_edges says of a pin has changed. */
void world_deferrable_edges(void *world);

/* Hand over by chip_pin_late what has been kept back up to the present clock. */
void world_late(void *world);

/* Levels of a pair of gate signals from now on: bit 0 the upper switch (PWM_A), bit 1 the lower one (PWM_B). */
void world_gates(void *world, unsigned module, unsigned submodule, unsigned levels);

/* The software has written levels of outputs. */
void world_outputs(void *world);

/* 12-bit code of an analogue pin at this instant: 0..7 ANA0-7, 8..15 ANB0-7. */
uint16_t world_convert(void *world, unsigned channel);

/* Software: after reset (memory lost); the body of an interrupt, which returns for how many clocks more than it has spent
 * (core_time.h) it keeps the core busy; and what runs when there is nothing else to do. */
void world_boot(void *world);
uint32_t world_interrupt(void *world, unsigned vector);
void world_background(void *world);

#endif

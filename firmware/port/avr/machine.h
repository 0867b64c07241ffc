/* machine.h - an ATmega2560 as a machine for test programs: `int` has 16 bits there, as on the 56800EX core.
 *
 * It has more RAM than the real one (simulator.c).
 */
#ifndef MACHINE_H
#define MACHINE_H

#include <stdint.h>

void machine_start(void);

/* Data that the simulator was started with. */
uint8_t machine_image(uint32_t at);

/* Text to the simulator's output. */
void machine_print(const char *text);

/* End the simulation with this exit status. */
void machine_stop(int status) __attribute__((noreturn));

#endif

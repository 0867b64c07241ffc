/* machine.h - an ATmega1284P as a machine for test programs: `int` has 16 bits there, as on the 56800EX core.
 *
 * Runs on simavr: `simavr -m atmega1284p -f 16000000 PROGRAM.elf`.
 */
#ifndef MACHINE_H
#define MACHINE_H

#include <stdint.h>

void machine_start(void);

/* Data that the program was linked with (image.S); flash is read beyond 64 kB too. */
uint8_t machine_image(uint32_t at);

/* Text to USART0. */
void machine_print(const char *text);

/* Sleep with interrupts off, which ends the simulation. */
void machine_stop(int status) __attribute__((noreturn));

#endif

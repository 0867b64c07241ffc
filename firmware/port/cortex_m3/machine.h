/* machine.h - a bare Cortex-M3 as a machine for test programs: the mps2-an385 board of QEMU.
 *
 *   qemu-system-arm -M mps2-an385 -display none -monitor none -serial stdio
 *       -semihosting-config enable=on,target=native -device loader,file=IMAGE,addr=0x21000000,force-raw=on
 *       -kernel PROGRAM.elf
 * Add -icount shift=10 to count instructions.
 */
#ifndef MACHINE_H
#define MACHINE_H

#include <stdint.h>

void machine_start(void);

/* Data that the simulator was started with, in external memory. */
uint8_t machine_image(uint32_t at);

/* Text to UART0. */
void machine_print(const char *text);

/* Eight hexadecimal digits and a line feed to UART0. */
void machine_print_hex(uint32_t value);

/* End the simulation with this exit status. */
void machine_stop(int status) __attribute__((noreturn));

/* A running counter for machine_instructions. Wraps after 655 000 instructions. */
uint32_t machine_clock(void);

/* Instructions from one reading of the clock to a later one, without those of reading it. */
uint32_t machine_instructions(uint32_t begin, uint32_t end);

#endif

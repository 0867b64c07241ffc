/* machine.h - the host as the machine of cost.c: its clock counts the charges of the firmware. */
#ifndef BENCH_HOST_MACHINE_H
#define BENCH_HOST_MACHINE_H

#include <stdint.h>

void machine_start(void);
uint8_t machine_image(uint32_t at);
void machine_print(const char *text);
void machine_stop(int status) __attribute__((noreturn));

uint32_t machine_clock(void);
static inline uint32_t machine_instructions(uint32_t begin, uint32_t end) { return end - begin; }

#endif

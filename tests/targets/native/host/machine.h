/* machine.h - the host as a machine for target programs: console is stdout, the image comes through stdin. */
#ifndef MACHINE_H
#define MACHINE_H

#include <stdint.h>

void machine_start(void);

/* Data that the program was started with; 0 behind its end. */
uint8_t machine_image(uint32_t at);

void machine_print(const char *text);
void machine_stop(int status);

#endif

/* machine.h - the host as a machine for target programs: console is stdout, the image is read from stdin. */
#ifndef MACHINE_H
#define MACHINE_H

#include <stdint.h>

void machine_start(void);

/* Data passed at the start of the program; 0 after its end. */
uint8_t machine_image(uint32_t at);

void machine_print(const char *text);
void machine_stop(int status);

#endif

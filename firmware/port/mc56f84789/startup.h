/* startup.h - the one board of a chip. Silicon only: on the host boards belong to their owner. */
#ifndef PORT_STARTUP_H
#define PORT_STARTUP_H

#include "port/mc56f84789/port.h"

extern hal_t startup_hal;

void startup_entry(void); /* out of reset: no stack, no data yet */
int main(void);

#endif

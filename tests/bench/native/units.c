/* units.c - charges of the firmware's files, by their number; the fourth byte of the image chooses one. */
#include "machine.h"

#define FILES_MAX 256

unsigned core_units[FILES_MAX];

uint32_t machine_clock(void) { return core_units[machine_image(3)]; }

#include "machine.h"

#include <avr/io.h>

#include "registers.h"

void machine_start(void) {}

uint8_t machine_image(uint32_t at)
{
    _SFR_MEM8(IMAGE_LOW) = (uint8_t)at;
    _SFR_MEM8(IMAGE_MIDDLE) = (uint8_t)(at >> 8);
    _SFR_MEM8(IMAGE_HIGH) = (uint8_t)(at >> 16);
    return _SFR_MEM8(IMAGE_HIGH);
}

void machine_print(const char *text)
{
    while (*text != '\0') {
        _SFR_MEM8(CONSOLE) = (uint8_t)*text;
        text++;
    }
}

void machine_stop(int status)
{
    _SFR_MEM8(STOP) = (uint8_t)status;
    for (;;) {
    }
}

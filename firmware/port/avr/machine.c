#include "machine.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>

#include "registers.h"

void machine_start(void)
{
    UCSR0A = (uint8_t)_BV(U2X0);
    UBRR0 = 0; /* 2 Mbit/s: as fast as it goes */
    UCSR0B = (uint8_t)_BV(TXEN0);
}

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
        loop_until_bit_is_set(UCSR0A, UDRE0);
        UDR0 = (uint8_t)*text;
        text++;
    }
}

void machine_stop(int status)
{
    (void)status; /* the simulator has no way to pass it on */
    loop_until_bit_is_set(UCSR0A, UDRE0);
    cli();
    for (;;) {
        sleep_mode();
    }
}

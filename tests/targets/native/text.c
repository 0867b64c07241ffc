#include "text.h"

#include "machine.h"

static void digits(uint32_t value, uint16_t count)
{
    char text[9];
    for (uint16_t i = 0; i < count; i++) {
        const uint8_t digit = (uint8_t)((value >> (4U * (count - 1U - i))) & 15U);
        text[i] = (char)((digit < 10U) ? '0' + digit : 'A' + digit - 10);
    }
    text[count] = '\0';
    machine_print(text);
}

void text_long(const char *head, uint32_t value, const char *tail)
{
    machine_print(head);
    digits(value, 8);
    machine_print(tail);
}

void text_word(const char *head, uint16_t value, const char *tail)
{
    machine_print(head);
    digits(value, 4);
    machine_print(tail);
}

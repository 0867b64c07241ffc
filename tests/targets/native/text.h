/* text.h - hexadecimal numbers on the console of a machine that has no printf. */
#ifndef TARGETS_TEXT_H
#define TARGETS_TEXT_H

#include <stdint.h>

/* Eight or four digits after `head`, which may be empty, followed by `tail`. */
void text_long(const char *head, uint32_t value, const char *tail);
void text_word(const char *head, uint16_t value, const char *tail);

#endif

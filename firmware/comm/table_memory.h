/* table_memory.h - TABLE_MEMORY: memory of large constant tables that only the server reads. Some processors (AVR)
 * cannot address it with a data pointer: read such a table with table_copy() and table_byte(). */
#ifndef COMM_TABLE_MEMORY_H
#define COMM_TABLE_MEMORY_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef __AVR__
#include <avr/pgmspace.h>
#define TABLE_MEMORY PROGMEM
static inline void table_copy(void *to, const void *from, size_t size) { (void)memcpy_P(to, from, size); }
static inline uint8_t table_byte(const uint8_t *at) { return pgm_read_byte(at); }
#else
#define TABLE_MEMORY
static inline void table_copy(void *to, const void *from, size_t size) { (void)memcpy(to, from, size); }
static inline uint8_t table_byte(const uint8_t *at) { return *at; }
#endif

#endif

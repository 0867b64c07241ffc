/* freemaster_harness.h - a FreeMASTER server on a serial line of two arrays, with an application that counts violations
 * of its interface. The table of variables is a generated source (freemaster_model.py). */
#ifndef FREEMASTER_HARNESS_H
#define FREEMASTER_HARNESS_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/freemaster.h"

extern const tsa_table_t fixture_table;
extern const uint8_t fixture_memory[];
extern const uint16_t fixture_memory_size;
extern const uint16_t fixture_live_size;

#define HARNESS_SAMPLES 1024 /* bytes of the recorders */

#define HARNESS_EVENTS 64

typedef enum { EVENT_LOCK, EVENT_UNLOCK, EVENT_WRITTEN, EVENT_COMMAND } harness_event_t;

typedef struct harness harness_t;

harness_t *harness_new(void);
void harness_free(harness_t *harness);

/* Restart the server, with the SHA-1 of a password for each level (NULL: no own password). */
void harness_set_passwords(harness_t *harness, const uint8_t *view, const uint8_t *command, const uint8_t *tune);
/* The application completes a pending command. */
void harness_finish(harness_t *harness, uint8_t code, const uint8_t *result, uint16_t size);
void harness_print(harness_t *harness, const uint8_t *text, uint16_t size);
uint8_t harness_level(const harness_t *harness);

/* Set the number of bytes that the transmitter accepts per poll. */
void harness_set_put_room(harness_t *harness, uint16_t bytes);

/* Send bytes to the server; bytes beyond the buffer are lost. */
void harness_feed(harness_t *harness, const uint8_t *data, uint16_t size);
void harness_poll(harness_t *harness);

/* Get the bytes sent by the server since the last call; the size of `data` is HARNESS_LINE bytes. */
#ifndef HARNESS_LINE
#define HARNESS_LINE 4096
#endif
uint16_t harness_take(harness_t *harness, uint8_t *data);

uint8_t harness_read(harness_t *harness, uint32_t address, uint8_t *data, uint16_t size);
uint8_t harness_write(harness_t *harness, uint32_t address, const uint8_t *data, const uint8_t *mask, uint16_t size);

/* Interface of the application. */
void harness_set_refusing(harness_t *harness, bool refusing); /* all later writes */
void harness_memory(const harness_t *harness, uint8_t *data);
void harness_poke(harness_t *harness, uint16_t offset, const uint8_t *data, uint16_t size);
void harness_poke_live(harness_t *harness, uint16_t offset, const uint8_t *data, uint16_t size);
void harness_sample(harness_t *harness, uint16_t recorder); /* one call of its loop */
uint16_t harness_events(harness_t *harness, uint16_t *triples); /* code, offset, size; emptied by the call */
uint16_t harness_violations(const harness_t *harness); /* calls out of order seen by the application */
void harness_statistics(const harness_t *harness, uint32_t values[6]);

#endif

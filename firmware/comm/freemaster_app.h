/* freemaster_app.h - what a FreeMASTER server needs from its application. */
#ifndef COMM_FREEMASTER_APP_H
#define COMM_FREEMASTER_APP_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/access.h"
#include "comm/app_command.h"
#include "comm/recorder.h"
#include "comm/tsa.h"

#define FREEMASTER_RECORDERS 2

/* What the application lends to the server; all pointers are needed and stay valid as long as the server. */
typedef struct {
    void *context; /* handed back with every call */
    uint8_t *memory;
    uint32_t memory_size; /* at most 65536: offsets of writes have 16 bits */
    const uint8_t *live; /* memory of the loops, for the sources of the table */
    uint32_t live_size; /* bytes */
    recorder_app_t recorder[FREEMASTER_RECORDERS];
    uint32_t *samples; /* of the recorders */
    uint16_t samples_size; /* bytes */
    const tsa_table_t *tsa;
    const char *name, *description, *version, *build;

    /* Freeze the snapshot and the command latch while bytes are copied. Never nested. */
    void (*lock)(void *context, bool on);

    /* Before each write, while locked: may `size` bytes at `offset` become `data`, where `mask` (NULL: everywhere) has
     * ones? The range is the one that written() would get; a refusal changes nothing and answers FM_OUT_OF_RANGE. */
    bool (*accepts)(void *context, uint16_t offset, const uint8_t *data, const uint8_t *mask, uint16_t size);

    /* After each accepted write, still locked: the smallest range that contains all bytes written (the bytes that
     * a mask leaves alone at either end do not count, and nothing is reported when none was written). */
    void (*written)(void *context, uint16_t offset, uint16_t size);

    app_command_run_t command;

    const char *console; /* name of its pipe */

    access_passwords_t passwords;

    /* A number that is hard to foresee, for the salt of a password. */
    uint32_t (*nonce)(void *context);

    /* The level that a client needs to write `size` bytes at `offset`: ACCESS_COMMAND or ACCESS_TUNE. */
    uint8_t (*level_to_write)(void *context, uint16_t offset, uint16_t size);
} freemaster_app_t;

#endif

/* freemaster_app.h - interface of the application to the FreeMASTER server: memory, tables, callbacks. */
#ifndef COMM_FREEMASTER_APP_H
#define COMM_FREEMASTER_APP_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/access.h"
#include "comm/app_command.h"
#include "comm/recorder.h"
#include "comm/tsa.h"

#define FREEMASTER_RECORDERS 2

/* Provided by the application; all pointers are required and must stay valid as long as the server. */
typedef struct {
    void *context; /* passed to every callback */
    uint8_t *memory; /* variables of the table */
    uint32_t memory_size; /* bytes; at most 65536, because offsets of writes have 16 bits */
    const uint8_t *live; /* memory of the control loops, for the sources of the table */
    uint32_t live_size; /* bytes */
    recorder_app_t recorder[FREEMASTER_RECORDERS];
    uint32_t *samples; /* sample memory of the recorders */
    uint16_t samples_size; /* bytes */
    const tsa_table_t *tsa;
    const char *name, *description, *version, *build;

    /* Freeze snapshot and command latch during copying. Not nested. */
    void (*lock)(void *context, bool on);

    /* Before each write, while locked: check `size` bytes of `data` at `offset`, with the bits set in `mask` (NULL:
     * all). The range is that passed to written(). A refusal changes nothing and is answered with FM_OUT_OF_RANGE. */
    bool (*accepts)(void *context, uint16_t offset, const uint8_t *data, const uint8_t *mask, uint16_t size);

    /* After each accepted write, while locked: smallest range that contains all written bytes, without bytes
     * excluded by the mask at both ends. Not called if no byte was written. */
    void (*written)(void *context, uint16_t offset, uint16_t size);

    app_command_run_t command;

    const char *console; /* name of the pipe */

    access_passwords_t passwords;

    /* Number for the salt of a password; differs for each call. */
    uint32_t (*nonce)(void *context);

    /* Access level required to write `size` bytes at `offset`: ACCESS_COMMAND or ACCESS_TUNE. */
    uint8_t (*level_to_write)(void *context, uint16_t offset, uint16_t size);
} freemaster_app_t;

#endif

/* freemaster.h - FreeMASTER v4 server: a client on the serial line reads and writes the variables of the application.
 *
 * One scope, recorders, application commands, target-side addressing with access check, passwords, one pipe. No
 * sessions: their commands are answered with FM_UNKNOWN_COMMAND. Each freemaster_t is an independent server.
 */
#ifndef COMM_FREEMASTER_H
#define COMM_FREEMASTER_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/access.h"
#include "comm/app_command.h"
#include "comm/frame.h"
#include "comm/freemaster_app.h"
#include "comm/pipe.h"
#include "comm/scope.h"
#include "comm/status.h"
#include "comm/tsa.h"
#include "hal/hal.h"

/* Counters since reset, modulo 2^32. */
typedef struct {
    uint32_t requests;   /* frames with a correct checksum; any of them shows that a host is connected */
    uint32_t refused;    /* requests answered with an error */
    uint32_t bad_crc;    /* frames with a wrong checksum */
    uint32_t too_long;   /* frames longer than the buffer */
    uint32_t aborted;    /* unfinished frames */
    uint32_t bytes_lost; /* bytes received while an answer was pending */
} freemaster_statistics_t;

typedef struct {
    freemaster_app_t app;
    tsa_space_t space;
    frame_receiver_t receiver;
    frame_event_t received; /* event that is not processed yet */
    frame_transmitter_t transmitter;
    scope_t scope;
    recorder_memory_t samples;
    recorder_t recorder[FREEMASTER_RECORDERS];
    app_command_t app_command;
    access_t access;
    pipe_t pipe;
    freemaster_statistics_t statistics;
} freemaster_t;

void freemaster_init(freemaster_t *server, const freemaster_app_t *app);

/* Transfer bytes from and to the serial line; process at most one request. Bytes received before the answer was sent
 * are discarded: a vendor target would destroy both answers. */
void freemaster_poll(freemaster_t *server, hal_t *hal);

/* freemaster_poll while the tables cannot be read: a received request waits for the next freemaster_poll. */
void freemaster_listen(freemaster_t *server, hal_t *hal);

/* Access level of the client on the line: ACCESS_NONE .. ACCESS_TUNE. */
uint8_t freemaster_level(const freemaster_t *server);

/* Finish a pending application command (app_command_finish); to be called in the background loop, like
 * freemaster_poll. */
void freemaster_finish_command(freemaster_t *server, uint8_t code, const uint8_t *result, uint16_t size);

/* Free bytes of the console of the client, and output of a text: completely or not at all. */
uint16_t freemaster_console_room(const freemaster_t *server);
void freemaster_print(freemaster_t *server, const uint8_t *text, uint16_t size);

/* READMEM and WRITEMEM without frame, size limit and password; 0 or a status code. `mask` may be NULL. */
fm_status_t freemaster_read(freemaster_t *server, uint32_t address, uint8_t *data, uint16_t size);
fm_status_t freemaster_write(freemaster_t *server, uint32_t address, const uint8_t *data, const uint8_t *mask,
                             uint16_t size);

#endif

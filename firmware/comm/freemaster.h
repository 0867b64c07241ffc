/* freemaster.h - FreeMASTER v4 server: lets a client on the serial line read and write the application's variables.
 *
 * One scope, recorders, application commands, target-side addressing with safety, passwords, a pipe; no sessions:
 * their commands answer FM_UNKNOWN_COMMAND. A server is one freemaster_t; any number may live side by side.
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
#include "comm/tsa.h"
#include "hal/hal.h"

/* Counters since start; they wrap. */
typedef struct {
    uint32_t requests;   /* frames with a right checksum: the sign of life of a host */
    uint32_t refused;    /* of these, answered with an error */
    uint32_t bad_crc;    /* frames with a wrong checksum */
    uint32_t too_long;   /* frames that did not fit */
    uint32_t aborted;    /* frames left unfinished */
    uint32_t bytes_lost; /* bytes that came in while an answer was due */
} freemaster_statistics_t;

typedef struct {
    freemaster_app_t app;
    tsa_space_t space;
    frame_receiver_t receiver;
    frame_event_t received; /* that has not been dealt with */
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

/* Move bytes from and to the serial line; carries out at most one request. What is received before its answer has been
 * handed to the line is dropped: a vendor target would destroy both answers. */
void freemaster_poll(freemaster_t *server, hal_t *hal);

/* The same while the tables cannot be read: a request that has come waits for the next freemaster_poll. */
void freemaster_listen(freemaster_t *server, hal_t *hal);

/* What the client on the line may do: ACCESS_NONE .. ACCESS_TUNE. */
uint8_t freemaster_level(const freemaster_t *server);

/* What the application has answered with APP_COMMAND_PENDING is done; see app_command_finish. From the background, as
 * freemaster_poll. */
void freemaster_finish_command(freemaster_t *server, uint8_t code, const uint8_t *result, uint16_t size);

/* Bytes of text that the client's console has room for now, and text for it: as a whole, or not at all. */
uint16_t freemaster_console_room(const freemaster_t *server);
void freemaster_print(freemaster_t *server, const uint8_t *text, uint16_t size);

/* As READMEM and WRITEMEM, without a frame, its limits and a password; 0 or a status code. `mask` may be NULL. */
uint8_t freemaster_read(freemaster_t *server, uint32_t address, uint8_t *data, uint16_t size);
uint8_t freemaster_write(freemaster_t *server, uint32_t address, const uint8_t *data, const uint8_t *mask,
                         uint16_t size);

#endif

/* pipe.h - text output of the application to a console of the client (PIPE, GETPIPE): one pipe, output only.
 *
 * The client reads the queued text and acknowledges it with its next request; until then the text is sent again. A
 * toggle bit distinguishes a new request from a repetition. Input of the client is accepted and ignored.
 */
#ifndef COMM_PIPE_H
#define COMM_PIPE_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/payload.h"
#include "comm/status.h"

#define PIPE_PORT UINT8_C(1)
#define PIPE_QUEUE 96 /* bytes */

typedef struct {
    const char *name; /* name of the pipe */
    bool odd; /* toggle bit of the next new request */
    uint8_t accepted; /* input bytes in the last new request */
    uint8_t size; /* queued bytes */
    uint8_t queue[PIPE_QUEUE]; /* text for the client, oldest byte first */
} pipe_t;

void pipe_init(pipe_t *pipe, const char *name);

/* Free bytes in the queue. */
static inline uint16_t pipe_room(const pipe_t *pipe) { return (uint16_t)(PIPE_QUEUE - pipe->size); }

/* Queue a text: completely, or not at all if there is no room. */
void pipe_write(pipe_t *pipe, const uint8_t *text, uint16_t size);

/* PIPE: u8 port with the toggle bit, u8 bytes received, data. */
fm_status_t pipe_exchange(pipe_t *pipe, payload_reader_t *request, payload_writer_t *reply);

/* GETPIPE: u8 flags, u8 index or port, u8 operation. */
fm_status_t pipe_query(const pipe_t *pipe, payload_reader_t *request, payload_writer_t *reply);

#endif

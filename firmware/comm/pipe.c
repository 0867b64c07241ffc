#include "comm/pipe.h"

#include <string.h>

#include "comm/frame.h"
#include "comm/status.h"

#define TOGGLE 0x80u
#define HEAD 3u /* length, port and number of accepted bytes before the text */
#define TEXT_MAX (FRAME_MTU - HEAD)

#define BY_PORT 0x01u /* flag: the number is a port, otherwise an index */
#define OPERATION_NAME 0x81u
#define TYPE_CONSOLE 0x00u
#define FLAG_OPEN 0x01u

void pipe_init(pipe_t *pipe, const char *name)
{
    pipe->name = name;
    pipe->odd = false;
    pipe->accepted = 0;
    pipe->size = 0;
}

void pipe_write(pipe_t *pipe, const uint8_t *text, uint16_t size)
{
    if (size <= pipe_room(pipe)) {
        memcpy(pipe->queue + pipe->size, text, size);
        pipe->size = (uint8_t)(pipe->size + size);
    }
}

static void drop(pipe_t *pipe, uint8_t size)
{
    const uint8_t gone = size < pipe->size ? size : pipe->size;
    pipe->size = (uint8_t)(pipe->size - gone);
    memmove(pipe->queue, pipe->queue + gone, pipe->size);
}

fm_status_t pipe_exchange(pipe_t *pipe, payload_reader_t *request, payload_writer_t *reply)
{
    const uint8_t port = payload_get_u8(request);
    const uint8_t received = payload_get_u8(request);
    if (request->missing || (port & ~TOGGLE) != PIPE_PORT) {
        return FM_PIPE;
    }
    if (((port & TOGGLE) != 0) == pipe->odd) {
        drop(pipe, received);
        pipe->accepted = (uint8_t)request->remaining;
        pipe->odd = !pipe->odd;
    }
    payload_put_u8(reply, port);
    payload_put_u8(reply, pipe->accepted);
    payload_put_bytes(reply, pipe->queue, pipe->size < TEXT_MAX ? pipe->size : (uint16_t)TEXT_MAX);
    return FM_OK_VARIABLE;
}

fm_status_t pipe_query(const pipe_t *pipe, payload_reader_t *request, payload_writer_t *reply)
{
    const uint8_t flags = payload_get_u8(request);
    const uint8_t number = payload_get_u8(request);
    if (request->missing) {
        return FM_PIPE;
    }
    if ((flags & BY_PORT) != 0 && number != PIPE_PORT) {
        return FM_PIPE;
    }
    if ((flags & BY_PORT) == 0 && number != 0) {
        return FM_BAD_INSTANCE;
    }
    if (payload_get_u8(request) == OPERATION_NAME) {
        payload_put_bytes(reply, (const uint8_t *)pipe->name, (uint16_t)strlen(pipe->name));
    } else {
        payload_put_u8(reply, PIPE_PORT);
        payload_put_u8(reply, TYPE_CONSOLE);
        payload_put_u8(reply, FLAG_OPEN);
    }
    return FM_OK_VARIABLE;
}

#include "comm/frame.h"

#include "comm/crc8.h"
#include "comm/status.h"

#define STATUS_AT 0u
#define LENGTH_AT 1u
#define DATA_AT 2u

void frame_receiver_init(frame_receiver_t *receiver)
{
    receiver->command = 0;
    receiver->size = 0;
    receiver->todo = 0;
    receiver->crc = CRC8_START;
    receiver->start = false;
    receiver->want_length = false;
    receiver->overflow = false;
}

/* A byte after an unpaired 2B is a command, in every state of the receiver. */
static frame_event_t begin(frame_receiver_t *receiver, uint8_t command)
{
    const bool unfinished = receiver->want_length || receiver->todo != 0;
    frame_receiver_init(receiver);
    receiver->command = command;
    receiver->crc = crc8_add(CRC8_START, command);
    receiver->want_length = true;
    return unfinished ? FRAME_ABORTED : FRAME_NOTHING;
}

static frame_event_t take_length(frame_receiver_t *receiver, uint8_t length)
{
    receiver->want_length = false;
    receiver->crc = crc8_add(receiver->crc, length);
    /* a frame with LEN = FF is discarded without an answer, as by the vendor's server */
    receiver->todo = (uint8_t)(length + 1u);
    return receiver->todo == 0 ? FRAME_ABORTED : FRAME_NOTHING;
}

static frame_event_t take_payload(frame_receiver_t *receiver, uint8_t byte)
{
    receiver->crc = crc8_add(receiver->crc, byte);
    if (receiver->size < FRAME_PAYLOAD_MAX) {
        receiver->payload[receiver->size++] = byte;
    } else {
        receiver->overflow = true;
    }
    return FRAME_NOTHING;
}

frame_event_t frame_receive(frame_receiver_t *receiver, uint8_t byte)
{
    if (byte == FRAME_START) {
        receiver->start = !receiver->start;
        if (receiver->start) {
            return FRAME_NOTHING;
        }
    } else if (receiver->start) {
        return begin(receiver, byte);
    }
    if (receiver->want_length) {
        return take_length(receiver, byte);
    }
    if (receiver->todo == 0) {
        return FRAME_NOTHING; /* noise between frames */
    }
    if (--receiver->todo != 0) {
        return take_payload(receiver, byte);
    }
    if (receiver->overflow) {
        return FRAME_TOO_LONG;
    }
    return byte == receiver->crc ? FRAME_COMPLETE : FRAME_CORRUPT;
}

void frame_transmitter_init(frame_transmitter_t *transmitter)
{
    transmitter->at = 0;
    transmitter->end = 0;
    transmitter->start = false;
    transmitter->repeat = false;
}

uint8_t *frame_data(frame_transmitter_t *transmitter) { return transmitter->bytes + DATA_AT; }

void frame_send(frame_transmitter_t *transmitter, fm_status_t status, uint16_t size)
{
    uint8_t *bytes = transmitter->bytes;
    const uint16_t data = fm_is_error(status) ? (uint16_t)0 : size;
    uint8_t crc = CRC8_START;

    transmitter->end = (uint16_t)(DATA_AT + data);
    if (status == FM_OK_VARIABLE) {
        transmitter->at = STATUS_AT;
        bytes[STATUS_AT] = status;
        bytes[LENGTH_AT] = (uint8_t)data;
    } else {
        transmitter->at = LENGTH_AT;
        bytes[LENGTH_AT] = status;
    }
    for (uint16_t i = transmitter->at; i < transmitter->end; i++) {
        crc = crc8_add(crc, bytes[i]);
    }
    bytes[transmitter->end++] = crc;
    transmitter->start = true;
    transmitter->repeat = false;
}

bool frame_is_sending(const frame_transmitter_t *transmitter)
{
    return transmitter->start || transmitter->at != transmitter->end;
}

bool frame_peek(const frame_transmitter_t *transmitter, uint8_t *byte)
{
    if (!frame_is_sending(transmitter)) {
        return false;
    }
    *byte = transmitter->start ? FRAME_START : transmitter->bytes[transmitter->at];
    return true;
}

void frame_advance(frame_transmitter_t *transmitter)
{
    if (transmitter->start) {
        transmitter->start = false;
    } else if (transmitter->bytes[transmitter->at] == FRAME_START && !transmitter->repeat) {
        transmitter->repeat = true;
    } else {
        transmitter->repeat = false;
        transmitter->at++;
    }
}

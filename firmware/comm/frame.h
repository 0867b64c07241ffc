/* frame.h - FreeMASTER v4 serial frames, byte by byte in both directions.
 *
 *   request   2B CMD LEN payload CRC        answer   2B STS [LEN] data CRC
 *
 * 2B starts a frame; each further byte 2B is sent twice. No time-out: a new start byte aborts an unfinished frame.
 */
#ifndef COMM_FRAME_H
#define COMM_FRAME_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/status.h"

/* Buffer size reported to the client; CMD and LEN of a request use two bytes of it. */
#ifndef FRAME_MTU
#define FRAME_MTU 254
#endif
#if FRAME_MTU < 32 || FRAME_MTU > 254
#error "the serial protocol supports buffers of 32 to 254 bytes"
#endif

#define FRAME_START UINT8_C(0x2B)
#define FRAME_PAYLOAD_MAX (FRAME_MTU - 2)
#define FRAME_DATA_MAX (FRAME_MTU < 252 ? FRAME_MTU : 252) /* largest number of data bytes in an answer */

typedef enum {
    FRAME_NOTHING,  /* frame not complete */
    FRAME_COMPLETE, /* command, payload and size are valid until the next byte */
    FRAME_TOO_LONG, /* answered in any case, without regard to the checksum */
    FRAME_CORRUPT,  /* wrong checksum */
    FRAME_ABORTED,  /* unfinished frame discarded; no answer */
} frame_event_t;

typedef struct {
    uint8_t payload[FRAME_PAYLOAD_MAX]; /* received payload, byte stuffing removed */
    uint8_t command; /* CMD byte */
    uint8_t size; /* stored payload bytes */
    uint8_t todo; /* remaining bytes, with the checksum */
    uint8_t crc; /* CRC of the received bytes */
    bool start; /* an unpaired 2B was received */
    bool want_length; /* the next byte is LEN */
    bool overflow; /* the payload does not fit */
} frame_receiver_t;

typedef struct {
    uint8_t bytes[2 + FRAME_DATA_MAX + 1]; /* STS, LEN, data, CRC; without LEN the frame begins at [1] */
    uint16_t at; /* next byte to send */
    uint16_t end; /* one past the last byte */
    bool start;  /* the start byte is to be sent next */
    bool repeat; /* the second 2B of a pair is to be sent next */
} frame_transmitter_t;

void frame_receiver_init(frame_receiver_t *receiver);
frame_event_t frame_receive(frame_receiver_t *receiver, uint8_t byte);

void frame_transmitter_init(frame_transmitter_t *transmitter);

/* Buffer for the data of the next answer; FRAME_DATA_MAX bytes. */
uint8_t *frame_data(frame_transmitter_t *transmitter);

/* Start sending an answer with the first `size` bytes of frame_data (no data with an error). */
void frame_send(frame_transmitter_t *transmitter, fm_status_t status, uint16_t size);

/* True until the last byte of the answer was sent. */
bool frame_is_sending(const frame_transmitter_t *transmitter);

/* Next byte to send, without removing it; false if there is none. frame_advance removes it. */
bool frame_peek(const frame_transmitter_t *transmitter, uint8_t *byte);
void frame_advance(frame_transmitter_t *transmitter);

#endif

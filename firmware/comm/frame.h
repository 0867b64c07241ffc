/* frame.h - FreeMASTER v4 serial frames, byte by byte in both directions.
 *
 *   request   2B CMD LEN payload CRC        answer   2B STS [LEN] data CRC
 *
 * 2B starts a block; every later byte of that value is sent twice. There is no time-out: a new start aborts.
 */
#ifndef COMM_FRAME_H
#define COMM_FRAME_H

#include <stdbool.h>
#include <stdint.h>

/* Message buffer as told to the client: a request takes two bytes of it for CMD and LEN. */
#ifndef FRAME_MTU
#define FRAME_MTU 254
#endif
#if FRAME_MTU < 32 || FRAME_MTU > 254
#error "the serial protocol supports buffers of 32 to 254 bytes"
#endif

#define FRAME_START UINT8_C(0x2B)
#define FRAME_PAYLOAD_MAX (FRAME_MTU - 2)
#define FRAME_DATA_MAX (FRAME_MTU < 252 ? FRAME_MTU : 252) /* the serial layer never sends more data bytes */

typedef enum {
    FRAME_NOTHING,  /* keep on feeding */
    FRAME_COMPLETE, /* command, payload and size are valid until the next byte */
    FRAME_TOO_LONG, /* to be answered, whether the checksum was right or not */
    FRAME_CORRUPT,
    FRAME_ABORTED, /* an unfinished frame was given up; nothing is answered */
} frame_event_t;

typedef struct {
    uint8_t payload[FRAME_PAYLOAD_MAX]; /* as received, stuffing removed */
    uint8_t command; /* CMD byte */
    uint8_t size; /* payload bytes stored */
    uint8_t todo; /* bytes to come, with the checksum */
    uint8_t crc; /* running CRC of what has come */
    bool start;       /* an unpaired 2B was seen */
    bool want_length; /* the next byte is LEN */
    bool overflow;
} frame_receiver_t;

typedef struct {
    uint8_t bytes[2 + FRAME_DATA_MAX + 1]; /* STS, LEN, data, CRC; without LEN the frame begins at [1] */
    uint16_t at; /* next byte to send */
    uint16_t end; /* one past the last byte */
    bool start;  /* the start byte is due */
    bool repeat; /* the second of a doubled byte is due */
} frame_transmitter_t;

void frame_receiver_init(frame_receiver_t *receiver);
frame_event_t frame_receive(frame_receiver_t *receiver, uint8_t byte);

void frame_transmitter_init(frame_transmitter_t *transmitter);

/* Where the data of the next answer are to be written; FRAME_DATA_MAX bytes. */
uint8_t *frame_data(frame_transmitter_t *transmitter);

/* Begin to send the answer with the first `size` bytes of frame_data (none in case of an error). */
void frame_send(frame_transmitter_t *transmitter, uint8_t status, uint16_t size);

/* True until the last byte of the answer has been taken. */
bool frame_is_sending(const frame_transmitter_t *transmitter);

/* The next byte for the wire; false when there is none. It stays the next one until frame_advance. */
bool frame_peek(const frame_transmitter_t *transmitter, uint8_t *byte);
void frame_advance(frame_transmitter_t *transmitter);

#endif

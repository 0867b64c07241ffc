/* serial_line.h - the line between the serial interface of a chip and the host.
 *
 * Both ends have a bit rate of their own: a byte is sampled in the middle of the bits that the receiver expects, so that
 * wrong settings give wrong bytes and framing errors, as on a wire. Clocks are those of the board (board_clock.h).
 */
#ifndef SERVO_TWIN_SERIAL_LINE_H
#define SERVO_TWIN_SERIAL_LINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define SERIAL_LINE_BITS 10u /* start, eight data, stop */
#define SERIAL_LINE_IN 4096   /* bytes that the host may write ahead of the wire */
#define SERIAL_LINE_OUT 65536 /* bytes that wait for the host */
#define SERIAL_LINE_IDLE UINT64_MAX

typedef struct {
    double byte_clocks; /* ten bits at the host's rate [clocks] */
    uint8_t in[SERIAL_LINE_IN];
    size_t in_head, in_size; /* bytes */
    uint64_t in_clock;       /* at which the byte on the wire is complete; SERIAL_LINE_IDLE without one */
    uint8_t out[SERIAL_LINE_OUT];
    size_t out_head, out_size; /* bytes */
    uint32_t overruns;         /* received bytes that the software did not read in time */
    uint32_t lost;             /* sent bytes that the host did not read in time */
} serial_line_t;

void serial_line_init(serial_line_t *line, double baud);

/* The host's end. Both return the number of bytes. */
size_t serial_line_write(serial_line_t *line, const uint8_t *data, size_t size, uint64_t now);
size_t serial_line_read(serial_line_t *line, uint8_t *data, size_t room);

/* The chip's end, whose byte takes `byte_clocks`: a byte has been sent; the byte that is complete, false for a framing error. */
void serial_line_send(serial_line_t *line, uint8_t byte, double byte_clocks);
bool serial_line_receive(serial_line_t *line, double byte_clocks, uint8_t *byte);

#endif

#include "serial_line.h"

#include "board_clock.h"

void serial_line_init(serial_line_t *line, double baud)
{
    line->byte_clocks = (double)SERIAL_LINE_BITS * (BOARD_CLOCK_MHZ * 1e6) / baud;
    line->in_clock = SERIAL_LINE_IDLE;
}

/* A byte sent in `sent` clocks, as a receiver that expects `expected` clocks samples it: each bit in its middle, counted from the
 * edge of the start bit. Returns false for a framing error. */
static bool sample_byte(uint8_t byte, double sent, double expected, uint8_t *result)
{
    unsigned bits = 0;
    for (unsigned k = 0; k < SERIAL_LINE_BITS; k++) {
        const double time = ((double)k + 0.5) * expected / sent;
        const unsigned at = (time < (double)SERIAL_LINE_BITS) ? (unsigned)time : SERIAL_LINE_BITS;
        const unsigned level = (at == 0) ? 0u : (at <= 8u) ? ((unsigned)byte >> (at - 1u)) & 1u : 1u;
        bits |= level << k;
    }
    *result = (uint8_t)(bits >> 1);
    return (bits >> (SERIAL_LINE_BITS - 1u)) != 0;
}

size_t serial_line_read(serial_line_t *line, uint8_t *data, size_t room)
{
    size_t taken = 0;
    while (taken < room && line->out_size > 0) {
        data[taken++] = line->out[line->out_head];
        line->out_head = (line->out_head + 1u) % SERIAL_LINE_OUT;
        line->out_size--;
    }
    return taken;
}

size_t serial_line_write(serial_line_t *line, const uint8_t *data, size_t size, uint64_t now)
{
    size_t taken = 0;
    while (taken < size && line->in_size < SERIAL_LINE_IN) {
        line->in[(line->in_head + line->in_size) % SERIAL_LINE_IN] = data[taken++];
        line->in_size++;
    }
    if (taken > 0 && line->in_clock == SERIAL_LINE_IDLE) {
        line->in_clock = now + (uint64_t)line->byte_clocks;
    }
    return taken;
}

void serial_line_send(serial_line_t *line, uint8_t byte, double byte_clocks)
{
    uint8_t received;
    (void)sample_byte(byte, byte_clocks, line->byte_clocks, &received);
    if (line->out_size < SERIAL_LINE_OUT) {
        line->out[(line->out_head + line->out_size++) % SERIAL_LINE_OUT] = received;
    } else {
        line->lost++;
    }
}

bool serial_line_receive(serial_line_t *line, double byte_clocks, uint8_t *byte)
{
    const uint8_t sent = line->in[line->in_head];
    line->in_head = (line->in_head + 1u) % SERIAL_LINE_IN;
    line->in_size--;
    line->in_clock = (line->in_size > 0) ? line->in_clock + (uint64_t)line->byte_clocks : SERIAL_LINE_IDLE;
    return sample_byte(sent, line->byte_clocks, byte_clocks, byte);
}

#include "chip/sci.h"

#include "chip/parts.h"

#define BASE 0xE080u
#define MODULE_SIZE 0x10u

enum { RATE, CTRL1, CTRL2, STAT, DATA, CTRL3 };

#define CTRL1_RE 0x0004u
#define CTRL1_TE 0x0008u
#define CTRL1_REIE 0x0010u
#define CTRL1_RFIE 0x0020u
#define CTRL1_TIIE 0x0040u
#define CTRL1_TEIE 0x0080u
#define CTRL2_FIFO_EN 0x0020u
#define CTRL2_RFWM(x) (((x) >> 6) & 3u)
#define CTRL2_TFWM(x) (((x) >> 11) & 3u)
#define STAT_FE 0x0200u
#define STAT_OR 0x0800u
#define STAT_RDRF 0x2000u
#define STAT_TIDLE 0x4000u
#define STAT_TDRE 0x8000u

#define BITS 10u /* start, eight data, stop */

static const uint8_t first_vector[SCI_MODULES] = {VECTOR_SCI0_RERR, VECTOR_SCI1_RERR, VECTOR_SCI2_RERR};

static unsigned depth(const sci_t *sci) { return ((sci->ctrl2 & CTRL2_FIFO_EN) != 0) ? SCI_FIFO : 1u; }

/* Bus clocks of ten bits: RATE counts eighths of sixteenths of a bit of the module's clock, which is the bus clock or
 * twice that. */
static double byte_clocks(const chip_t *chip, unsigned m)
{
    const double clocks = 2.0 * (double)BITS * (double)chip->sci[m].rate;
    return (((chip->sim.pcr >> (13u - m)) & 1u) != 0) ? 0.5 * clocks : clocks;
}

static bool alive(const chip_t *chip, unsigned m) { return chip->sci[m].rate != 0 && sim_gate_open(chip, 1, 12u - m); }

static uint16_t status(const sci_t *sci)
{
    const bool fifo = (sci->ctrl2 & CTRL2_FIFO_EN) != 0;
    const unsigned full = fifo ? CTRL2_RFWM(sci->ctrl2) : 0u;
    const unsigned empty = fifo ? CTRL2_TFWM(sci->ctrl2) : 0u;
    unsigned stat = sci->errors;
    stat |= (sci->rx_count > full) ? STAT_RDRF : 0u;
    stat |= (sci->tx_count <= empty) ? STAT_TDRE : 0u;
    stat |= (sci->tx_count == 0 && sci->shift_clock == CHIP_NEVER) ? STAT_TIDLE : 0u;
    return (uint16_t)stat;
}

static void request(chip_t *chip, unsigned m)
{
    const sci_t *sci = &chip->sci[m];
    const unsigned stat = status(sci);
    const unsigned vector = first_vector[m];
    intc_request(chip, vector, (stat & (STAT_OR | STAT_FE)) != 0 && (sci->ctrl1 & CTRL1_REIE) != 0);
    intc_request(chip, vector + 1u, (stat & (STAT_RDRF | STAT_OR)) != 0 && (sci->ctrl1 & CTRL1_RFIE) != 0);
    intc_request(chip, vector + 2u, (stat & STAT_TIDLE) != 0 && (sci->ctrl1 & CTRL1_TIIE) != 0);
    intc_request(chip, vector + 3u, (stat & STAT_TDRE) != 0 && (sci->ctrl1 & CTRL1_TEIE) != 0);
    core_wake(chip);
}

/* What a receiver makes of a byte whose bits last `sent` while it believes in `heard`: each bit in its middle, from the
 * edge of the start bit on. Returns false for a framing error. */
static bool sample_byte(uint8_t byte, double sent, double heard, uint8_t *result)
{
    unsigned bits = 0;
    for (unsigned k = 0; k < BITS; k++) {
        const double time = ((double)k + 0.5) * heard / sent;
        const unsigned at = (time < (double)BITS) ? (unsigned)time : BITS;
        const unsigned level = (at == 0) ? 0u : (at <= 8u) ? ((unsigned)byte >> (at - 1u)) & 1u : 1u;
        bits |= level << k;
    }
    *result = (uint8_t)(bits >> 1);
    return (bits >> (BITS - 1u)) != 0;
}

/* ---- to the host ----------------------------------------------------------------------------------------------------- */

static void schedule(chip_t *chip) { chip_schedule(chip, SOURCE_SERIAL, chip_line_next(chip)); }

static void send_next(chip_t *chip, unsigned m)
{
    sci_t *sci = &chip->sci[m];
    sci->shift_clock = CHIP_NEVER;
    if (sci->tx_count > 0 && (sci->ctrl1 & CTRL1_TE) != 0 && alive(chip, m)) {
        sci->shift = sci->tx[0];
        sci->tx_count--;
        for (unsigned i = 0; i < sci->tx_count; i++) {
            sci->tx[i] = sci->tx[i + 1u];
        }
        sci->shift_clock = chip->now + (uint64_t)byte_clocks(chip, m);
    }
    schedule(chip);
}

static void sent(chip_t *chip, unsigned m)
{
    const sci_t *sci = &chip->sci[m];
    if (sci->shift_clock > chip->now) {
        return;
    }
    if (pins_function(chip, chip->config.wiring.txd) == (pin_function_t)(FUNCTION_TXD0 + m)) {
        sci_line_t *line = &chip->line;
        uint8_t byte;
        (void)sample_byte(sci->shift, byte_clocks(chip, m), line->byte_clocks, &byte);
        if (line->out_size < SCI_LINE_OUT) {
            line->out[(line->out_head + line->out_size++) % SCI_LINE_OUT] = byte;
        } else {
            line->lost++;
        }
    }
    send_next(chip, m);
    request(chip, m);
}

size_t chip_line_read(chip_t *chip, uint8_t *data, size_t room)
{
    sci_line_t *line = &chip->line;
    size_t taken = 0;
    while (taken < room && line->out_size > 0) {
        data[taken++] = line->out[line->out_head];
        line->out_head = (line->out_head + 1u) % SCI_LINE_OUT;
        line->out_size--;
    }
    return taken;
}

/* ---- from the host --------------------------------------------------------------------------------------------------- */

static void receive(chip_t *chip, unsigned m, uint8_t byte)
{
    sci_t *sci = &chip->sci[m];
    if ((sci->ctrl1 & CTRL1_RE) == 0 || !alive(chip, m)) {
        return;
    }
    uint8_t heard;
    const bool framed = sample_byte(byte, chip->line.byte_clocks, byte_clocks(chip, m), &heard);
    if ((sci->errors & STAT_OR) != 0 || sci->rx_count >= depth(sci)) {
        sci->errors |= STAT_OR; /* what has come is lost, what waits stays */
        chip->line.overruns++;
    } else {
        sci->rx[sci->rx_count++] = heard;
        sci->errors = (uint16_t)(sci->errors | (framed ? 0u : STAT_FE));
    }
    request(chip, m);
}

static void arrived(chip_t *chip)
{
    sci_line_t *line = &chip->line;
    if (line->in_clock > chip->now) {
        return;
    }
    const uint8_t byte = line->in[line->in_head];
    line->in_head = (line->in_head + 1u) % SCI_LINE_IN;
    line->in_size--;
    line->in_clock = (line->in_size > 0) ? line->in_clock + (uint64_t)line->byte_clocks : CHIP_NEVER;
    schedule(chip);
    for (unsigned m = 0; m < SCI_MODULES; m++) {
        if (pins_function(chip, chip->config.wiring.rxd) == (pin_function_t)(FUNCTION_RXD0 + m)) {
            receive(chip, m, byte);
        }
    }
}

void sci_event(chip_t *chip)
{
    for (unsigned m = 0; m < SCI_MODULES; m++) {
        sent(chip, m);
    }
    arrived(chip);
}

size_t chip_line_write(chip_t *chip, const uint8_t *data, size_t size)
{
    sci_line_t *line = &chip->line;
    size_t taken = 0;
    while (taken < size && line->in_size < SCI_LINE_IN) {
        line->in[(line->in_head + line->in_size++) % SCI_LINE_IN] = data[taken++];
    }
    if (taken > 0 && line->in_clock == CHIP_NEVER) {
        line->in_clock = chip->now + (uint64_t)line->byte_clocks;
        schedule(chip);
    }
    return taken;
}

uint64_t chip_line_next(const chip_t *chip)
{
    uint64_t next = chip->line.in_clock;
    for (unsigned m = 0; m < SCI_MODULES; m++) {
        next = (chip->sci[m].shift_clock < next) ? chip->sci[m].shift_clock : next;
    }
    return next;
}

/* ---- registers ------------------------------------------------------------------------------------------------------- */

uint16_t sci_read(chip_t *chip, uint32_t address)
{
    const unsigned m = (address - BASE) / MODULE_SIZE;
    sci_t *sci = &chip->sci[m];
    sim_gate(chip, address, 1, 12u - m);
    switch (address & 0xFu) {
    case RATE:
        return sci->rate;
    case CTRL1:
        return sci->ctrl1;
    case CTRL2:
        return (uint16_t)(sci->ctrl2 | sci->rx_count << 8 | sci->tx_count << 13);
    case STAT:
        sci->stat_read = true;
        return status(sci);
    case DATA: {
        const uint8_t byte = sci->rx[0];
        const bool takes = sci->rx_count > 0 && (sci->stat_read || (sci->ctrl2 & CTRL2_FIFO_EN) != 0);
        if (takes) {
            sci->rx_count--;
            for (unsigned i = 0; i < sci->rx_count; i++) {
                sci->rx[i] = sci->rx[i + 1u];
            }
            sci->stat_read = sci->stat_read && (sci->ctrl2 & CTRL2_FIFO_EN) != 0;
            request(chip, m);
        }
        return byte;
    }
    case CTRL3:
        return sci->ctrl3;
    default:
        chip_no_register(chip, address);
    }
}

void sci_write(chip_t *chip, uint32_t address, uint16_t value)
{
    const unsigned m = (address - BASE) / MODULE_SIZE;
    sci_t *sci = &chip->sci[m];
    sim_gate(chip, address, 1, 12u - m);
    switch (address & 0xFu) {
    case RATE:
        sci->rate = value;
        break;
    case CTRL1:
        chip_only(chip, address, value, 0x00FC, "break, wake-up, parity, nine bits and loops are not modelled");
        sci->ctrl1 = value;
        break;
    case CTRL2:
        sci->ctrl2 = value & 0x18E0u;
        chip_only(chip, address, value & 0x001Fu, 0, "DMA, LIN and RIEIE are not modelled");
        break;
    case STAT:
        if (sci->stat_read) {
            sci->errors = 0;
        }
        break;
    case DATA:
        if (sci->tx_count >= depth(sci)) {
            chip_no_value(chip, address, value, "written while the transmitter is full");
        }
        sci->tx[sci->tx_count++] = (uint8_t)value;
        if (sci->shift_clock == CHIP_NEVER) {
            send_next(chip, m);
        }
        break;
    case CTRL3:
        chip_only(chip, address, value, 0, "stop-mode hold is not modelled");
        break;
    default:
        chip_no_register(chip, address);
    }
    if (sci->shift_clock == CHIP_NEVER && sci->tx_count > 0) {
        send_next(chip, m);
    }
    request(chip, m);
}

void sci_reset(chip_t *chip)
{
    for (unsigned m = 0; m < SCI_MODULES; m++) {
        chip->sci[m] = (sci_t){.shift_clock = CHIP_NEVER};
    }
    schedule(chip);
}

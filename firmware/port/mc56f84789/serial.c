/* serial.c - the host's line: received by interrupt into a ring, sent through the interface's FIFO. */
#include "port/mc56f84789/drivers.h"

#define REG(reg) (QSCI0_BASE + (reg))
#define RING_MASK (PORT_RING - 1U)
#define ERRORS (QSCI_STAT_OR | QSCI_STAT_NF | QSCI_STAT_FE | QSCI_STAT_PF)

/* Register RATE: SERIAL_CLOCK_HZ / (16 x baud), with three fraction bits. */
static uint16_t rate(uint32_t baud)
{
    const uint32_t eighths = (uint32_t)SERIAL_RATE_OF(baud);
    return (eighths < SERIAL_RATE_MIN)   ? (uint16_t)SERIAL_RATE_MIN
           : (eighths > SERIAL_RATE_MAX) ? (uint16_t)SERIAL_RATE_MAX
                                         : (uint16_t)eighths;
}

void serial_init(hal_t *hal)
{
    const uint32_t baud = (hal->baud != 0U) ? hal->baud : SERIAL_BAUD;
    REG_WRITE(hal, REG(QSCI_CTRL1), 0U);
    REG_WRITE(hal, REG(QSCI_RATE), rate(baud));
    REG_WRITE(hal, REG(QSCI_CTRL3), 0U);
    REG_WRITE(hal, REG(QSCI_CTRL2), SET_QSCI_CTRL2);
    REG_WRITE(hal, REG(QSCI_CTRL1), SET_QSCI_CTRL1);
    hal->slow_line = baud <= SERIAL_FETCHED_MAX;
    hal->ring_in = 0;
    hal->ring_out = 0;
    hal->overruns = 0;
}

static bool waiting(hal_t *hal) { return (REG_READ(hal, REG(QSCI_CTRL2)) & QSCI_CTRL2_RFCNT_MASK) != 0U; }

/* RDRF is cleared by reading STAT and then the data; errors are cleared by reading and then writing STAT. */
void port_receive(hal_t *hal)
{
    const uint16_t stat = REG_READ(hal, REG(QSCI_STAT));
    REG_WRITE(hal, REG(QSCI_CTRL2), SET_QSCI_CTRL2);
    while (waiting(hal)) {
        const uint16_t data = REG_READ(hal, REG(QSCI_DATA));
        const uint16_t in = hal->ring_in;
        if ((uint16_t)(in - hal->ring_out) < PORT_RING) {
            hal->ring[in & RING_MASK] = (uint8_t)data;
            hal->ring_in = (uint16_t)(in + 1U);
        } else {
            hal->overruns++;
        }
    }
    if ((stat & ERRORS) != 0U) { /* the checksum of a frame detects corrupted bytes */
        if ((stat & QSCI_STAT_OR) != 0U) {
            hal->overruns++;
        }
        REG_WRITE(hal, REG(QSCI_STAT), 0U);
    }
}

uint16_t hal_receiver_overruns(hal_t *hal) { return hal->overruns; }

/* Bytes below the watermark. On a slow line the background reads them: an interrupt per byte would delay M1 and M2. On
 * a fast line M1 and M2 may interrupt the background for longer than the FIFO takes to fill: then the watermark is
 * lowered to one byte. */
static void fetch_rest(hal_t *hal)
{
    if (hal->slow_line) {
        REG_WRITE(hal, REG(QSCI_CTRL1), SET_QSCI_CTRL1 & (uint16_t)~QSCI_CTRL1_RFIE);
        port_receive(hal);
        REG_WRITE(hal, REG(QSCI_CTRL1), SET_QSCI_CTRL1);
    } else {
        REG_WRITE(hal, REG(QSCI_CTRL2), SET_QSCI_CTRL2_REST);
    }
}

bool hal_serial_get(hal_t *hal, uint8_t *byte)
{
    const uint16_t out = hal->ring_out;
    if (out == hal->ring_in) {
        if (!waiting(hal)) {
            return false;
        }
        fetch_rest(hal);
        if (out == hal->ring_in) {
            return false; /* the interrupt is pending */
        }
    }
    *byte = hal->ring[out & RING_MASK];
    hal->ring_out = (uint16_t)(out + 1U);
    return true;
}

bool hal_serial_put(hal_t *hal, uint8_t byte)
{
    const uint16_t queued = FIELD_GET(REG_READ(hal, REG(QSCI_CTRL2)), QSCI_CTRL2_TFCNT_MASK);
    if (queued >= QSCI_FIFO_WORDS) {
        return false;
    }
    REG_WRITE(hal, REG(QSCI_DATA), byte);
    return true;
}

#include "chip/sci.h"

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

static const uint8_t first_vector[SCI_MODULES] = {VECTOR_SCI0_RERR, VECTOR_SCI1_RERR, VECTOR_SCI2_RERR};

static unsigned depth(const sci_module_t *module) { return ((module->ctrl2 & CTRL2_FIFO_EN) != 0) ? SCI_FIFO : 1u; }

/* Bus clocks of ten bits: RATE counts eighths of sixteenths of a bit of the module's clock, which is the bus clock or
 * twice that. */
static double byte_clocks(const sci_t *sci, unsigned m)
{
    const double clocks = 2.0 * (double)SERIAL_LINE_BITS * (double)sci->module[m].rate;
    return (((sci->bus->sim.pcr >> (13u - m)) & 1u) != 0) ? 0.5 * clocks : clocks;
}

static bool alive(const sci_t *sci, unsigned m)
{
    return sci->module[m].rate != 0 && bus_gate_open(sci->bus, 1, 12u - m);
}

static uint16_t status(const sci_module_t *module)
{
    const bool fifo = (module->ctrl2 & CTRL2_FIFO_EN) != 0;
    const unsigned full = fifo ? CTRL2_RFWM(module->ctrl2) : 0u;
    const unsigned empty = fifo ? CTRL2_TFWM(module->ctrl2) : 0u;
    unsigned stat = module->errors;
    stat |= (module->rx_count > full) ? STAT_RDRF : 0u;
    stat |= (module->tx_count <= empty) ? STAT_TDRE : 0u;
    stat |= (module->tx_count == 0 && module->shift_clock == CHIP_NEVER) ? STAT_TIDLE : 0u;
    return (uint16_t)stat;
}

static void request(sci_t *sci, unsigned m)
{
    const sci_module_t *module = &sci->module[m];
    const unsigned stat = status(module);
    const unsigned vector = first_vector[m];
    bus_request(sci->bus, vector, (stat & (STAT_OR | STAT_FE)) != 0 && (module->ctrl1 & CTRL1_REIE) != 0);
    bus_request(sci->bus, vector + 1u, (stat & (STAT_RDRF | STAT_OR)) != 0 && (module->ctrl1 & CTRL1_RFIE) != 0);
    bus_request(sci->bus, vector + 2u, (stat & STAT_TIDLE) != 0 && (module->ctrl1 & CTRL1_TIIE) != 0);
    bus_request(sci->bus, vector + 3u, (stat & STAT_TDRE) != 0 && (module->ctrl1 & CTRL1_TEIE) != 0);
    bus_wake_background(sci->bus);
}

/* ---- to the host ----------------------------------------------------------------------------------------------------- */

static void schedule(sci_t *sci) { bus_plan(sci->bus, SOURCE_SERIAL, sci_line_next(sci)); }

static void send_next(sci_t *sci, unsigned m)
{
    sci_module_t *module = &sci->module[m];
    module->shift_clock = CHIP_NEVER;
    if (module->tx_count > 0 && (module->ctrl1 & CTRL1_TE) != 0 && alive(sci, m)) {
        module->shift = module->tx[0];
        module->tx_count--;
        for (unsigned i = 0; i < module->tx_count; i++) {
            module->tx[i] = module->tx[i + 1u];
        }
        module->shift_clock = sci->bus->now + (uint64_t)byte_clocks(sci, m);
    }
    schedule(sci);
}

static void sent(sci_t *sci, unsigned m)
{
    const sci_module_t *module = &sci->module[m];
    if (module->shift_clock > sci->bus->now) {
        return;
    }
    if (m == sci->sender) {
        serial_line_send(&sci->line, module->shift, byte_clocks(sci, m));
    }
    send_next(sci, m);
    request(sci, m);
}

/* ---- from the host --------------------------------------------------------------------------------------------------- */

static void receive(sci_t *sci, unsigned m, uint8_t received, bool framed)
{
    sci_module_t *module = &sci->module[m];
    if ((module->errors & STAT_OR) != 0 || module->rx_count >= depth(module)) {
        module->errors |= STAT_OR; /* the new byte is lost */
        sci->line.overruns++;
    } else {
        module->rx[module->rx_count++] = received;
        module->errors = (uint16_t)(module->errors | (framed ? 0u : STAT_FE));
    }
    request(sci, m);
}

static void arrived(sci_t *sci)
{
    serial_line_t *line = &sci->line;
    if (line->in_clock > sci->bus->now) {
        return;
    }
    const unsigned m = sci->receiver;
    const bool listens = m < SCI_MODULES && (sci->module[m].ctrl1 & CTRL1_RE) != 0 && alive(sci, m);
    uint8_t byte;
    const bool framed = serial_line_receive(line, listens ? byte_clocks(sci, m) : line->byte_clocks, &byte);
    schedule(sci);
    if (listens) {
        receive(sci, m, byte, framed);
    }
}

void sci_event(void *peripheral, unsigned source)
{
    sci_t *sci = (sci_t *)peripheral;
    (void)source;
    for (unsigned m = 0; m < SCI_MODULES; m++) {
        sent(sci, m);
    }
    arrived(sci);
}

size_t sci_line_write(sci_t *sci, const uint8_t *data, size_t size)
{
    const size_t taken = serial_line_write(&sci->line, data, size, sci->bus->now);
    schedule(sci);
    return taken;
}

uint64_t sci_line_next(const sci_t *sci)
{
    uint64_t next = sci->line.in_clock;
    for (unsigned m = 0; m < SCI_MODULES; m++) {
        next = (sci->module[m].shift_clock < next) ? sci->module[m].shift_clock : next;
    }
    return next;
}

/* ---- registers ------------------------------------------------------------------------------------------------------- */

uint16_t sci_read(void *peripheral, uint32_t address)
{
    sci_t *sci = (sci_t *)peripheral;
    const unsigned m = (address - SCI_BASE) / MODULE_SIZE;
    sci_module_t *module = &sci->module[m];
    bus_check_gate(sci->bus, address, 1, 12u - m);
    switch (address & 0xFu) {
    case RATE:
        return module->rate;
    case CTRL1:
        return module->ctrl1;
    case CTRL2:
        return (uint16_t)(module->ctrl2 | module->rx_count << 8 | module->tx_count << 13);
    case STAT:
        module->stat_read = true;
        return status(module);
    case DATA: {
        const uint8_t byte = module->rx[0];
        const bool takes = module->rx_count > 0 && (module->stat_read || (module->ctrl2 & CTRL2_FIFO_EN) != 0);
        if (takes) {
            module->rx_count--;
            for (unsigned i = 0; i < module->rx_count; i++) {
                module->rx[i] = module->rx[i + 1u];
            }
            module->stat_read = module->stat_read && (module->ctrl2 & CTRL2_FIFO_EN) != 0;
            request(sci, m);
        }
        return byte;
    }
    case CTRL3:
        return module->ctrl3;
    default:
        bus_no_register(sci->bus, address);
    }
}

void sci_write(void *peripheral, uint32_t address, uint16_t value)
{
    sci_t *sci = (sci_t *)peripheral;
    const unsigned m = (address - SCI_BASE) / MODULE_SIZE;
    sci_module_t *module = &sci->module[m];
    bus_check_gate(sci->bus, address, 1, 12u - m);
    switch (address & 0xFu) {
    case RATE:
        module->rate = value;
        break;
    case CTRL1:
        bus_allow(sci->bus, address, value, 0x00FC, "break, wake-up, parity, nine bits and loops are not modelled");
        module->ctrl1 = value;
        break;
    case CTRL2:
        module->ctrl2 = value & 0x18E0u;
        bus_allow(sci->bus, address, value & 0x001Fu, 0, "DMA, LIN and RIEIE are not modelled");
        break;
    case STAT:
        if (module->stat_read) {
            module->errors = 0;
        }
        break;
    case DATA:
        if (module->tx_count >= depth(module)) {
            bus_no_value(sci->bus, address, value, "written while the transmitter is full");
        }
        module->tx[module->tx_count++] = (uint8_t)value;
        if (module->shift_clock == CHIP_NEVER) {
            send_next(sci, m);
        }
        break;
    case CTRL3:
        bus_allow(sci->bus, address, value, 0, "stop-mode hold is not modelled");
        break;
    default:
        bus_no_register(sci->bus, address);
    }
    if (module->shift_clock == CHIP_NEVER && module->tx_count > 0) {
        send_next(sci, m);
    }
    request(sci, m);
}

void sci_reset(void *peripheral)
{
    sci_t *sci = (sci_t *)peripheral;
    for (unsigned m = 0; m < SCI_MODULES; m++) {
        sci->module[m] = (sci_module_t){.shift_clock = CHIP_NEVER};
    }
    schedule(sci);
}

void sci_init(sci_t *sci, bus_t *bus, double baud)
{
    sci->bus = bus;
    sci->sender = sci->receiver = SCI_MODULES;
    serial_line_init(&sci->line, baud);
}

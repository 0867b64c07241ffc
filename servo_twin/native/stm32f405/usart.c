#include "stm32f405/usart.h"

#include "port/stm32f405/registers.h"

#define NAME "USART2"
#define GATE 17u /* of APB1 */
#define CR1_TCIE 0x40u /* bits which the port does not use */
#define CR1_RXNEIE 0x20u
#define CR1_TXEIE 0x80u
#define CR1_MODELLED (USART_CR1_RE | USART_CR1_TE | CR1_RXNEIE | CR1_TCIE | CR1_TXEIE | USART_CR1_UE)
#define ERRORS (USART_SR_PE | USART_SR_FE | USART_SR_NF | USART_SR_ORE)

/* Clocks of a byte: BRR is the clock of APB1 per bit. */
static double byte_clocks(const usart_t *usart)
{
    return (double)SERIAL_LINE_BITS * SOC_APB1_CLOCKS * (double)usart->brr;
}

static bool enabled(const usart_t *usart, uint32_t direction)
{
    return (usart->cr1 & USART_CR1_UE) != 0 && (usart->cr1 & direction) != 0 && usart->brr != 0;
}

static uint32_t status(const usart_t *usart)
{
    return usart->flags | (usart->tx_full ? 0u : USART_SR_TXE) | (usart->sent ? USART_SR_TC : 0u);
}

static void request(usart_t *usart)
{
    soc_t *soc = usart->soc;
    const uint32_t sr = status(usart);
    const bool on = ((sr & (USART_SR_RXNE | USART_SR_ORE)) != 0 && (usart->cr1 & CR1_RXNEIE) != 0) ||
                    ((sr & USART_SR_TXE) != 0 && (usart->cr1 & CR1_TXEIE) != 0) ||
                    ((sr & USART_SR_TC) != 0 && (usart->cr1 & CR1_TCIE) != 0);
    soc_request(soc, SOC_IRQ_USART2, 0, on);
    soc->signals->dma_request(soc->chip, SOC_DMA_USART2_RX,
                              (usart->cr3 & USART_CR3_DMAR) != 0 && (usart->flags & USART_SR_RXNE) != 0);
    soc->signals->dma_request(soc->chip, SOC_DMA_USART2_TX,
                              (usart->cr3 & USART_CR3_DMAT) != 0 && enabled(usart, USART_CR1_TE) && !usart->tx_full);
}

uint64_t usart_line_next(const usart_t *usart) { return events_earlier(usart->line.in_clock, usart->shift_clock); }

static void schedule(usart_t *usart) { bus_plan(&usart->soc->bus, SOC_EVENT_USART, usart_line_next(usart)); }

/* ---- to the host ---------------------------------------------------------------------------------------------------- */

static void send_next(usart_t *usart)
{
    if (usart->shift_clock != CHIP_NEVER || !usart->tx_full || !enabled(usart, USART_CR1_TE)) {
        return;
    }
    soc_need_clock(usart->soc, NAME);
    usart->shift = usart->tx;
    usart->tx_full = false;
    usart->sent = false;
    usart->shift_clock = usart->soc->bus.now + (uint64_t)byte_clocks(usart);
}

static void complete(usart_t *usart)
{
    if (usart->shift_clock > usart->soc->bus.now) {
        return;
    }
    usart->shift_clock = CHIP_NEVER;
    if (usart->sends) {
        serial_line_send(&usart->line, usart->shift, byte_clocks(usart));
    }
    usart->sent = !usart->tx_full;
    send_next(usart);
}

/* ---- from the host -------------------------------------------------------------------------------------------------- */

static void receive(usart_t *usart)
{
    serial_line_t *line = &usart->line;
    if (line->in_clock > usart->soc->bus.now) {
        return;
    }
    const bool listens = usart->receives && enabled(usart, USART_CR1_RE);
    uint8_t byte;
    const bool framed = serial_line_receive(line, listens ? byte_clocks(usart) : line->byte_clocks, &byte);
    if (!listens) {
        return;
    }
    if ((usart->flags & USART_SR_RXNE) != 0) {
        usart->flags |= USART_SR_ORE; /* the new byte is lost */
        line->overruns++;
    } else {
        usart->rx = byte;
        usart->flags |= USART_SR_RXNE | (framed ? 0u : USART_SR_FE);
    }
    usart->status_read = false;
}

void usart_event(void *peripheral, unsigned source)
{
    usart_t *usart = (usart_t *)peripheral;
    (void)source;
    complete(usart);
    receive(usart);
    request(usart);
    schedule(usart);
}

size_t usart_line_write(usart_t *usart, const uint8_t *data, size_t size)
{
    const size_t taken = serial_line_write(&usart->line, data, size, usart->soc->bus.now);
    schedule(usart);
    return taken;
}

/* ---- registers ------------------------------------------------------------------------------------------------------ */

uint32_t usart_read(void *peripheral, uint32_t offset)
{
    usart_t *usart = (usart_t *)peripheral;
    soc_check_gate(usart->soc, NAME, SOC_APB1, GATE);
    switch (offset) {
    case USART_SR:
        usart->status_read = true;
        return status(usart);
    case USART_DR:
        usart->flags &= ~(USART_SR_RXNE | (usart->status_read ? ERRORS : 0u));
        usart->status_read = false;
        request(usart);
        return usart->rx;
    case USART_BRR:
        return usart->brr;
    case USART_CR1:
        return usart->cr1;
    case USART_CR2:
        return usart->cr2;
    case USART_CR3:
        return usart->cr3;
    default:
        soc_no_register(usart->soc, NAME, offset);
    }
}

void usart_write(void *peripheral, uint32_t offset, uint32_t value)
{
    usart_t *usart = (usart_t *)peripheral;
    soc_check_gate(usart->soc, NAME, SOC_APB1, GATE);
    switch (offset) {
    case USART_SR:
        usart->sent = usart->sent && (value & USART_SR_TC) != 0;
        usart->flags &= value | ~USART_SR_RXNE;
        break;
    case USART_DR:
        if (usart->tx_full) {
            soc_no_value(usart->soc, NAME, offset, value, "written while the transmitter is full");
        }
        usart->tx = (uint8_t)value;
        usart->tx_full = true;
        break;
    case USART_BRR:
        usart->brr = value & 0xFFFFu;
        break;
    case USART_CR1:
        soc_allow(usart->soc, NAME, offset, value, CR1_MODELLED,
                  "parity, nine bits, wake-up, idle detection and sampling by 8 are not modelled");
        usart->cr1 = value;
        break;
    case USART_CR2:
        soc_allow(usart->soc, NAME, offset, value, 0, "stop bits, clock output and LIN are not modelled");
        usart->cr2 = value;
        break;
    case USART_CR3:
        soc_allow(usart->soc, NAME, offset, value, USART_CR3_DMAR | USART_CR3_DMAT, "other modes are not modelled");
        usart->cr3 = value;
        break;
    default:
        soc_no_register(usart->soc, NAME, offset);
    }
    send_next(usart);
    request(usart);
    schedule(usart);
}

void usart_reset(void *peripheral, soc_reset_t cause)
{
    usart_t *usart = (usart_t *)peripheral;
    (void)cause;
    usart->flags = usart->brr = usart->cr1 = usart->cr2 = usart->cr3 = 0;
    usart->sends = usart->receives = usart->tx_full = usart->status_read = false;
    usart->sent = true;
    usart->shift_clock = CHIP_NEVER;
    request(usart);
    schedule(usart);
}

void usart_init(usart_t *usart, soc_t *soc, double baud)
{
    usart->soc = soc;
    serial_line_init(&usart->line, baud);
}

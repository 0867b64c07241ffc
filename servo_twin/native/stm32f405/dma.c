#include "stm32f405/dma.h"

#include "port/stm32f405/registers.h"

#define CONTROLLER_SIZE 0x400u
#define GATE_DMA1 21u /* of AHB1 */
#define STREAM_SIZE 0x18u
#define SCR_HTIE 8u
#define SCR_MODELLED                                                                                                   \
    (DMA_SCR_EN | 0x0Eu | DMA_SCR_TCIE | FIELD_MASK(DMA_SCR_DIR) | DMA_SCR_CIRC | DMA_SCR_MINC |                       \
     FIELD_MASK(DMA_SCR_PSIZE) | FIELD_MASK(DMA_SCR_MSIZE) | FIELD_MASK(DMA_SCR_PL) | FIELD_MASK(DMA_SCR_CHSEL))

static const char *const names[DMA_CONTROLLERS] = {"DMA1", "DMA2"};

/* Streams and channels of the requests (RM0090, tables of DMA1 and DMA2). */
static const struct {
    uint8_t controller, stream, channel, request;
} table[] = {
    {0, 5, 4, SOC_DMA_USART2_RX}, {0, 6, 4, SOC_DMA_USART2_TX}, {0, 0, 0, SOC_DMA_SPI3_RX}, {0, 2, 0, SOC_DMA_SPI3_RX},
    {0, 5, 0, SOC_DMA_SPI3_TX},   {0, 7, 0, SOC_DMA_SPI3_TX},   {1, 0, 0, SOC_DMA_ADC1},    {1, 4, 0, SOC_DMA_ADC1},
    {1, 2, 1, SOC_DMA_ADC2},      {1, 3, 1, SOC_DMA_ADC2},      {1, 0, 2, SOC_DMA_ADC3},    {1, 1, 2, SOC_DMA_ADC3},
};

#define ENTRIES (sizeof table / sizeof table[0])

static unsigned irq_of(unsigned c, unsigned s)
{
    if (c == 0) {
        return (s < 7u) ? SOC_IRQ_DMA1_S0 + s : (unsigned)SOC_IRQ_DMA1_S7;
    }
    return (s < 5u) ? SOC_IRQ_DMA2_S0 + s : SOC_IRQ_DMA2_S5 + s - 5u;
}

static void request_interrupt(dma_t *dma, unsigned c, unsigned s)
{
    const dma_stream_t *stream = &dma->stream[c][s];
    const uint32_t flags = dma->flags[c][s / 4u];
    soc_request(dma->soc, irq_of(c, s), 0,
                ((flags & DMA_ISR_TCIF(s)) != 0 && (stream->cr & DMA_SCR_TCIE) != 0) ||
                    ((flags & DMA_ISR_HTIF(s)) != 0 && (stream->cr & SCR_HTIE) != 0));
}

static void transfer(dma_t *dma, unsigned c, unsigned s)
{
    dma_stream_t *stream = &dma->stream[c][s];
    soc_t *soc = dma->soc;
    const unsigned size = 1u << FIELD_GET(stream->cr, DMA_SCR_PSIZE);
    const uint32_t memory =
        stream->m0ar + (((stream->cr & DMA_SCR_MINC) != 0) ? size * (stream->start - stream->ndtr) : 0u);
    const bool to_memory = FIELD_GET(stream->cr, DMA_SCR_DIR) == DMA_SCR_DIR_TO_MEMORY;
    const uint32_t from = to_memory ? stream->par : memory, to = to_memory ? memory : stream->par;
    uint32_t value = 0;
    if (!soc->signals->dma_read(soc->chip, from, size, &value) ||
        !soc->signals->dma_write(soc->chip, to, size, value)) {
        bus_fail(&soc->bus, "%s stream %u reads %08lXh or writes %08lXh, where it cannot", names[c], s,
                 (unsigned long)from, (unsigned long)to);
    }
    stream->ndtr--;
    if (2u * stream->ndtr == stream->start) {
        dma->flags[c][s / 4u] |= DMA_ISR_HTIF(s);
    }
    if (stream->ndtr == 0) {
        dma->flags[c][s / 4u] |= DMA_ISR_TCIF(s);
        if ((stream->cr & DMA_SCR_CIRC) != 0) {
            stream->ndtr = stream->start;
        } else {
            stream->cr &= ~DMA_SCR_EN;
        }
    }
    request_interrupt(dma, c, s);
}

/* Serve what is requested, until nothing is. */
static void serve(dma_t *dma)
{
    if (dma->busy) {
        return; /* a transfer of this loop has changed a request */
    }
    dma->busy = true;
    for (bool more = true; more;) {
        more = false;
        for (unsigned k = 0; k < ENTRIES; k++) {
            const dma_stream_t *stream = &dma->stream[table[k].controller][table[k].stream];
            if ((dma->requests >> table[k].request & 1u) != 0 && (stream->cr & DMA_SCR_EN) != 0 &&
                FIELD_GET(stream->cr, DMA_SCR_CHSEL) == table[k].channel) {
                transfer(dma, table[k].controller, table[k].stream);
                more = true;
            }
        }
    }
    dma->busy = false;
}

void dma_request(dma_t *dma, soc_dma_t request, bool on)
{
    const uint32_t bit = UINT32_C(1) << request;
    dma->requests = on ? dma->requests | bit : dma->requests & ~bit;
    if (on) {
        serve(dma);
    }
}

/* ---- registers ------------------------------------------------------------------------------------------------------ */

static dma_stream_t *stream_at(dma_t *dma, unsigned c, uint32_t at, uint32_t *offset)
{
    const uint32_t within = at - DMA_SCR(0);
    if (at < DMA_SCR(0) || within / STREAM_SIZE >= DMA_STREAMS) {
        soc_no_register(dma->soc, names[c], at);
    }
    *offset = DMA_SCR(0) + within % STREAM_SIZE;
    return &dma->stream[c][within / STREAM_SIZE];
}

uint32_t dma_read(void *peripheral, uint32_t address)
{
    dma_t *dma = (dma_t *)peripheral;
    const unsigned c = address / CONTROLLER_SIZE;
    const uint32_t at = address % CONTROLLER_SIZE;
    soc_check_gate(dma->soc, names[c], SOC_AHB1, GATE_DMA1 + c);
    if (at < DMA_IFCR(0)) {
        return dma->flags[c][at / 4u];
    }
    uint32_t offset;
    const dma_stream_t *stream = stream_at(dma, c, at, &offset);
    switch (offset) {
    case DMA_SCR(0):
        return stream->cr;
    case DMA_SNDTR(0):
        return stream->ndtr;
    case DMA_SPAR(0):
        return stream->par;
    case DMA_SM0AR(0):
        return stream->m0ar;
    case DMA_SFCR(0):
        return stream->fcr;
    default:
        soc_no_register(dma->soc, names[c], at);
    }
}

static void write_cr(dma_t *dma, unsigned c, uint32_t at, dma_stream_t *stream, uint32_t value)
{
    const bool enabled = (stream->cr & DMA_SCR_EN) != 0;
    soc_allow(dma->soc, names[c], at, value, SCR_MODELLED,
              "double buffers, bursts, fixed increments and flow control by a peripheral are not modelled");
    if (FIELD_GET(value, DMA_SCR_DIR) > DMA_SCR_DIR_TO_PERIPHERAL ||
        FIELD_GET(value, DMA_SCR_PSIZE) != FIELD_GET(value, DMA_SCR_MSIZE)) {
        soc_no_value(dma->soc, names[c], at, value, "transfers within memory and two sizes are not modelled");
    }
    if (enabled && (value & DMA_SCR_EN) != 0 && value != stream->cr) {
        soc_no_value(dma->soc, names[c], at, value, "changed while the stream is enabled");
    }
    if (!enabled && (value & DMA_SCR_EN) != 0) {
        const unsigned s = (unsigned)(stream - dma->stream[c]);
        if ((dma->flags[c][s / 4u] & DMA_ISR_ALL(s)) != 0) {
            soc_no_value(dma->soc, names[c], at, value, "enabled before its flags are cleared");
        }
        stream->start = stream->ndtr;
    }
    stream->cr = value;
    if ((value & DMA_SCR_EN) != 0 && stream->ndtr == 0) {
        stream->cr &= ~DMA_SCR_EN;
    }
}

void dma_write(void *peripheral, uint32_t address, uint32_t value)
{
    dma_t *dma = (dma_t *)peripheral;
    const unsigned c = address / CONTROLLER_SIZE;
    const uint32_t at = address % CONTROLLER_SIZE;
    soc_check_gate(dma->soc, names[c], SOC_AHB1, GATE_DMA1 + c);
    if (at >= DMA_IFCR(0) && at < DMA_SCR(0)) {
        dma->flags[c][(at - DMA_IFCR(0)) / 4u] &= ~value;
        for (unsigned s = 0; s < DMA_STREAMS; s++) {
            request_interrupt(dma, c, s);
        }
        return;
    }
    uint32_t offset;
    dma_stream_t *stream = stream_at(dma, c, at, &offset);
    if ((stream->cr & DMA_SCR_EN) != 0 && offset != DMA_SCR(0)) {
        soc_no_value(dma->soc, names[c], at, value, "written while the stream is enabled");
    }
    switch (offset) {
    case DMA_SCR(0):
        write_cr(dma, c, at, stream, value);
        break;
    case DMA_SNDTR(0):
        stream->ndtr = value & 0xFFFFu;
        break;
    case DMA_SPAR(0):
        stream->par = value;
        break;
    case DMA_SM0AR(0):
        stream->m0ar = value;
        break;
    case DMA_SFCR(0):
        soc_allow(dma->soc, names[c], at, value, 0x23u, "the FIFO is not modelled");
        stream->fcr = value;
        break;
    default:
        soc_no_register(dma->soc, names[c], at);
    }
    request_interrupt(dma, c, (unsigned)(stream - dma->stream[c]));
    serve(dma);
}

void dma_reset(void *peripheral, soc_reset_t cause)
{
    dma_t *dma = (dma_t *)peripheral;
    (void)cause;
    for (unsigned c = 0; c < DMA_CONTROLLERS; c++) {
        dma->flags[c][0] = dma->flags[c][1] = 0;
        for (unsigned s = 0; s < DMA_STREAMS; s++) {
            dma->stream[c][s] = (dma_stream_t){.fcr = 0x21u};
            request_interrupt(dma, c, s);
        }
    }
    dma->busy = false;
}

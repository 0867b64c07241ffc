/* serial.c - the host's line: USART2, two rings that DMA fills and empties. */
#include "port/stm32f405/drivers.h"

#define USART(reg) (USART2_BASE + (reg))
#define DMA(reg) (DMA1_BASE + (reg))
#define RING_MASK (RING_BYTES - 1U)

void serial_init(hal_t *hal)
{
    const uint32_t baud = (hal->baud == 0U) ? SERIAL_BAUD : (hal->baud > SERIAL_BAUD_MAX) ? SERIAL_BAUD_MAX : hal->baud;
    REG_WRITE(hal, USART(USART_CR1), 0U);
    REG_WRITE(hal, USART(USART_BRR), SERIAL_DIVIDER(baud));
    REG_WRITE(hal, USART(USART_CR2), 0U);
    REG_WRITE(hal, USART(USART_CR3), SET_USART_CR3);

    REG_WRITE(hal, DMA(DMA_IFCR(STREAM_RECEIVE)), DMA_ISR_ALL(STREAM_RECEIVE) | DMA_ISR_ALL(STREAM_TRANSMIT));
    REG_WRITE(hal, DMA(DMA_SPAR(STREAM_RECEIVE)), USART(USART_DR));
    REG_WRITE(hal, DMA(DMA_SM0AR(STREAM_RECEIVE)), BUS_ADDRESS(hal->dma->receive));
    REG_WRITE(hal, DMA(DMA_SNDTR(STREAM_RECEIVE)), RING_BYTES);
    REG_WRITE(hal, DMA(DMA_SCR(STREAM_RECEIVE)), SET_DMA_RECEIVE | DMA_SCR_EN);
    REG_WRITE(hal, DMA(DMA_SPAR(STREAM_TRANSMIT)), USART(USART_DR));
    REG_WRITE(hal, USART(USART_CR1), SET_USART_CR1);

    hal->receive_out = 0;
    hal->receive_laps = 0;
    hal->transmit_in = 0;
    hal->transmit_out = 0;
    hal->transmitting = 0;
    hal->overruns = 0;
}

/* ---- received bytes --------------------------------------------------------------------------------------------- */

/* An overrun is cleared by reading the status, then the data; the checksum of a frame detects the lost bytes. */
static void note_overrun(hal_t *hal)
{
    if ((REG_READ(hal, USART(USART_SR)) & USART_SR_ORE) != 0U) {
        (void)REG_READ(hal, USART(USART_DR));
        hal->overruns++;
    }
}

/* Bytes that wait. DMA may begin another lap between the reads of its flag and of its counter: then the number is
 * negative, until the next call. */
static uint16_t waiting(hal_t *hal)
{
    if ((REG_READ(hal, DMA(DMA_ISR(STREAM_RECEIVE))) & DMA_ISR_TCIF(STREAM_RECEIVE)) != 0U) {
        REG_WRITE(hal, DMA(DMA_IFCR(STREAM_RECEIVE)), DMA_ISR_TCIF(STREAM_RECEIVE));
        hal->receive_laps++;
    }
    const uint32_t at = (RING_BYTES - REG_READ(hal, DMA(DMA_SNDTR(STREAM_RECEIVE)))) & RING_MASK;
    const uint16_t bytes = (uint16_t)(hal->receive_laps * RING_BYTES + at - hal->receive_out);
    return (bytes > UINT16_MAX / 2U) ? 0U : bytes;
}

bool hal_serial_get(hal_t *hal, uint8_t *byte)
{
    const uint16_t bytes = waiting(hal);
    if (bytes == 0U) {
        note_overrun(hal);
        return false;
    }
    if (bytes > RING_BYTES) { /* the oldest are overwritten */
        hal->overruns = (uint16_t)(hal->overruns + bytes);
        hal->receive_out = (uint16_t)(hal->receive_out + bytes);
        return false;
    }
    *byte = hal->dma->receive[hal->receive_out & RING_MASK];
    hal->receive_out++;
    return true;
}

uint16_t hal_receiver_overruns(hal_t *hal) { return hal->overruns; }

/* ---- bytes to send ---------------------------------------------------------------------------------------------- */

/* A transfer goes up to the end of the ring at most. The stream switches itself off at its end. */
void serial_service(hal_t *hal)
{
    if (hal->transmitting != 0U) {
        if ((REG_READ(hal, DMA(DMA_SCR(STREAM_TRANSMIT))) & DMA_SCR_EN) != 0U) {
            return;
        }
        REG_WRITE(hal, DMA(DMA_IFCR(STREAM_TRANSMIT)), DMA_ISR_ALL(STREAM_TRANSMIT));
        hal->transmit_out = (uint16_t)(hal->transmit_out + hal->transmitting);
        hal->transmitting = 0;
    }
    const uint16_t from = hal->transmit_out & RING_MASK;
    const uint16_t bytes = (uint16_t)(hal->transmit_in - hal->transmit_out);
    const uint16_t straight = (uint16_t)(RING_BYTES - from);
    hal->transmitting = (bytes < straight) ? bytes : straight;
    if (hal->transmitting != 0U) {
        REG_WRITE(hal, DMA(DMA_SM0AR(STREAM_TRANSMIT)), BUS_ADDRESS(hal->dma->transmit) + from);
        REG_WRITE(hal, DMA(DMA_SNDTR(STREAM_TRANSMIT)), hal->transmitting);
        REG_WRITE(hal, DMA(DMA_SCR(STREAM_TRANSMIT)), SET_DMA_TRANSMIT | DMA_SCR_EN);
    }
}

bool hal_serial_put(hal_t *hal, uint8_t byte)
{
    if ((uint16_t)(hal->transmit_in - hal->transmit_out) >= RING_BYTES) {
        return false;
    }
    hal->dma->transmit[hal->transmit_in & RING_MASK] = byte;
    hal->transmit_in++;
    return true;
}

#include "stm32f405/spi.h"

#include "port/stm32f405/registers.h"

#define NAME "SPI3"
#define GATE 15u /* of APB1 */
#define BITS 16u
#define CR1_MODELLED                                                                                                   \
    (SPI_CR1_CPHA | SPI_CR1_CPOL | SPI_CR1_MSTR | FIELD_MASK(SPI_CR1_BR) | SPI_CR1_SPE | SPI_CR1_SSI | SPI_CR1_SSM |   \
     SPI_CR1_DFF)
#define CR1_NEEDED (SPI_CR1_MSTR | SPI_CR1_SPE | SPI_CR1_SSM | SPI_CR1_SSI | SPI_CR1_DFF)
#define CR2_RXNEIE 0x40u
#define CR2_TXEIE 0x80u
#define FASTEST_OK 10.5e6 /* of the gate drivers [Hz] */

static uint32_t status(const spi_t *spi)
{
    return spi->flags | (spi->tx_full ? 0u : SPI_SR_TXE) | (spi->busy ? SPI_SR_BSY : 0u);
}

static void request(spi_t *spi)
{
    const uint32_t sr = status(spi);
    soc_request(spi->soc, SOC_IRQ_SPI3, 0,
                ((sr & (SPI_SR_RXNE | SPI_SR_OVR)) != 0 && (spi->cr2 & CR2_RXNEIE) != 0) ||
                    ((sr & SPI_SR_TXE) != 0 && (spi->cr2 & CR2_TXEIE) != 0));
}

/* Clocks of 168 MHz per bit. */
static uint64_t bit_clocks(const spi_t *spi)
{
    return (uint64_t)SOC_APB1_CLOCKS * (2u << FIELD_GET(spi->cr1, SPI_CR1_BR));
}

static void send_next(spi_t *spi)
{
    if (spi->busy || !spi->tx_full || (spi->cr1 & SPI_CR1_SPE) == 0) {
        return;
    }
    soc_need_clock(spi->soc, NAME);
    spi->shift = spi->tx;
    spi->tx_full = false;
    spi->busy = true;
    bus_plan(&spi->soc->bus, SOC_EVENT_SPI, spi->soc->bus.now + BITS * bit_clocks(spi));
}

/* The devices change their output with the rising edge of a clock that rests low, and sample with the falling one. */
static bool fits_devices(const spi_t *spi)
{
    return spi->connected && (spi->cr1 & (SPI_CR1_CPHA | SPI_CR1_CPOL)) == SPI_CR1_CPHA &&
           SOC_HZ / (double)bit_clocks(spi) <= FASTEST_OK;
}

void spi_event(void *peripheral, unsigned source)
{
    spi_t *spi = (spi_t *)peripheral;
    bus_plan(&spi->soc->bus, source, CHIP_NEVER);
    const uint16_t answer = fits_devices(spi) ? spi->soc->signals->spi_exchange(spi->soc->chip, spi->shift) : 0xFFFFu;
    spi->busy = false;
    if ((spi->flags & SPI_SR_RXNE) != 0) {
        spi->flags |= SPI_SR_OVR;
    } else {
        spi->rx = answer;
        spi->flags |= SPI_SR_RXNE;
    }
    send_next(spi);
    request(spi);
}

uint32_t spi_read(void *peripheral, uint32_t offset)
{
    spi_t *spi = (spi_t *)peripheral;
    soc_check_gate(spi->soc, NAME, SOC_APB1, GATE);
    switch (offset) {
    case SPI_CR1:
        return spi->cr1;
    case SPI_CR2:
        return spi->cr2;
    case SPI_SR:
        return status(spi);
    case SPI_DR:
        spi->flags &= ~(SPI_SR_RXNE | SPI_SR_OVR);
        request(spi);
        return spi->rx;
    default:
        soc_no_register(spi->soc, NAME, offset);
    }
}

void spi_write(void *peripheral, uint32_t offset, uint32_t value)
{
    spi_t *spi = (spi_t *)peripheral;
    soc_check_gate(spi->soc, NAME, SOC_APB1, GATE);
    switch (offset) {
    case SPI_CR1:
        soc_allow(spi->soc, NAME, offset, value, CR1_MODELLED, "CRC, one wire and LSB first are not modelled");
        if ((value & SPI_CR1_SPE) != 0 && (value & CR1_NEEDED) != CR1_NEEDED) {
            soc_no_value(spi->soc, NAME, offset, value,
                         "only a master with 16 bits and a select by software is modelled");
        }
        if (spi->busy && value != spi->cr1) {
            soc_no_value(spi->soc, NAME, offset, value, "changed during a frame");
        }
        spi->cr1 = value;
        break;
    case SPI_CR2:
        soc_allow(spi->soc, NAME, offset, value, CR2_RXNEIE | CR2_TXEIE, "DMA of this interface is not modelled");
        spi->cr2 = value;
        break;
    case SPI_DR:
        if (spi->tx_full) {
            soc_no_value(spi->soc, NAME, offset, value, "written while the transmitter is full");
        }
        spi->tx = (uint16_t)value;
        spi->tx_full = true;
        break;
    default:
        soc_no_register(spi->soc, NAME, offset);
    }
    send_next(spi);
    request(spi);
}

void spi_reset(void *peripheral, soc_reset_t cause)
{
    spi_t *spi = (spi_t *)peripheral;
    (void)cause;
    *spi = (spi_t){.soc = spi->soc};
    bus_plan(&spi->soc->bus, SOC_EVENT_SPI, CHIP_NEVER);
    request(spi);
}

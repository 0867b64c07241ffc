/* usart.h - USART2 and the serial line to the host: eight bits, no parity, one stop bit, sampled 16 times. */
#ifndef STM32F405_USART_H
#define STM32F405_USART_H

#include "serial_line.h"
#include "stm32f405/soc.h"

typedef struct {
    soc_t *soc;
    serial_line_t line;
    bool sends, receives; /* the pins have the function */
    uint32_t flags; /* PE, FE, NF, ORE, RXNE of SR */
    uint32_t brr, cr1, cr2, cr3;
    bool status_read; /* SR was read with the present flags of errors */
    uint8_t rx, tx, shift;
    bool tx_full; /* DR waits for the shift register */
    bool sent; /* TC */
    uint64_t shift_clock; /* at which the byte on the wire is complete; CHIP_NEVER without one */
} usart_t;

uint32_t usart_read(void *usart, uint32_t offset);
void usart_write(void *usart, uint32_t offset, uint32_t value);
void usart_reset(void *usart, soc_reset_t cause);
void usart_event(void *usart, unsigned source);
void usart_init(usart_t *usart, soc_t *soc, double baud);

/* The host sends: serial_line_write. */
size_t usart_line_write(usart_t *usart, const uint8_t *data, size_t size);

/* Clock at which the next byte on the wire is complete; CHIP_NEVER without one. */
uint64_t usart_line_next(const usart_t *usart);

#endif

/* uart.h - model of serial line and SCI: ten bit times per byte, receive FIFO of four bytes, transmitter with one buffered
 * byte. */
#ifndef SERVO_TWIN_UART_H
#define SERVO_TWIN_UART_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define UART_IDLE UINT64_MAX
#define UART_RX_FIFO 4
#define UART_RX_LINE 4096 /* buffered bytes of the host, waiting for transmission */
#define UART_TX_LINE 65536 /* buffered bytes for the host */

typedef struct {
    uint64_t byte_ns; /* duration of a byte, with start and stop bit [ns] */
    /* host to board */
    uint8_t rx_line[UART_RX_LINE];
    size_t rx_head, rx_size;
    uint64_t rx_done_ns; /* end of the byte in transmission [ns]; UART_IDLE: none */
    uint8_t rx_fifo[UART_RX_FIFO];
    unsigned rx_count;
    uint32_t overruns; /* bytes lost because the software did not fetch them */
    /* board to host */
    uint8_t tx_shift, tx_wait;
    bool tx_waiting;
    uint64_t tx_done_ns; /* end of the byte in the shift register [ns] */
    uint8_t tx_line[UART_TX_LINE];
    size_t tx_head, tx_size;
    uint32_t tx_lost; /* bytes that the host did not fetch in time */
} uart_t;

void uart_init(uart_t *uart, double baud);

/* End of the next byte in transmission; UART_IDLE: none. */
uint64_t uart_next_ns(const uart_t *uart);

/* Complete the bytes that are due at `now_ns`. */
void uart_run(uart_t *uart, uint64_t now_ns);

/* Access by the software: hal_serial_get and hal_serial_put. */
bool uart_get(uart_t *uart, uint8_t *byte);
bool uart_put(uart_t *uart, uint8_t byte, uint64_t now_ns);

/* Access by the host. */
size_t uart_host_write(uart_t *uart, const uint8_t *data, size_t size, uint64_t now_ns);
size_t uart_host_read(uart_t *uart, uint8_t *data, size_t room);

#endif

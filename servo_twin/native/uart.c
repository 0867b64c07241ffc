#include "uart.h"

#define BITS_PER_BYTE 10.0 /* start, eight data, stop */

void uart_init(uart_t *uart, double baud)
{
    /* no compound literal: it would pass the buffers over the stack */
    uart->byte_ns = (uint64_t)(BITS_PER_BYTE * 1e9 / baud + 0.5);
    uart->rx_head = uart->rx_size = 0;
    uart->rx_done_ns = UART_IDLE;
    uart->rx_count = 0;
    uart->overruns = 0;
    uart->tx_waiting = false;
    uart->tx_done_ns = UART_IDLE;
    uart->tx_head = uart->tx_size = 0;
    uart->tx_lost = 0;
}

uint64_t uart_next_ns(const uart_t *uart)
{
    return (uart->rx_done_ns < uart->tx_done_ns) ? uart->rx_done_ns : uart->tx_done_ns;
}

static void receive_one(uart_t *uart)
{
    const uint8_t byte = uart->rx_line[uart->rx_head];
    uart->rx_head = (uart->rx_head + 1) % UART_RX_LINE;
    uart->rx_size--;
    uart->rx_done_ns = (uart->rx_size > 0) ? uart->rx_done_ns + uart->byte_ns : UART_IDLE;
    if (uart->rx_count < UART_RX_FIFO) {
        uart->rx_fifo[uart->rx_count++] = byte;
    } else {
        uart->overruns++;
    }
}

static void transmit_one(uart_t *uart)
{
    if (uart->tx_size < UART_TX_LINE) {
        uart->tx_line[(uart->tx_head + uart->tx_size) % UART_TX_LINE] = uart->tx_shift;
        uart->tx_size++;
    } else {
        uart->tx_lost++;
    }
    uart->tx_shift = uart->tx_wait;
    uart->tx_done_ns = uart->tx_waiting ? uart->tx_done_ns + uart->byte_ns : UART_IDLE;
    uart->tx_waiting = false;
}

void uart_run(uart_t *uart, uint64_t now_ns)
{
    if (uart->rx_done_ns <= now_ns) {
        receive_one(uart);
    }
    if (uart->tx_done_ns <= now_ns) {
        transmit_one(uart);
    }
}

bool uart_get(uart_t *uart, uint8_t *byte)
{
    if (uart->rx_count == 0) {
        return false;
    }
    *byte = uart->rx_fifo[0];
    uart->rx_count--;
    for (unsigned i = 0; i < uart->rx_count; i++) {
        uart->rx_fifo[i] = uart->rx_fifo[i + 1];
    }
    return true;
}

bool uart_put(uart_t *uart, uint8_t byte, uint64_t now_ns)
{
    if (uart->tx_done_ns == UART_IDLE) {
        uart->tx_shift = byte;
        uart->tx_done_ns = now_ns + uart->byte_ns;
        return true;
    }
    if (uart->tx_waiting) {
        return false;
    }
    uart->tx_wait = byte;
    uart->tx_waiting = true;
    return true;
}

size_t uart_host_write(uart_t *uart, const uint8_t *data, size_t size, uint64_t now_ns)
{
    size_t taken = 0;
    while (taken < size && uart->rx_size < UART_RX_LINE) {
        uart->rx_line[(uart->rx_head + uart->rx_size) % UART_RX_LINE] = data[taken++];
        uart->rx_size++;
    }
    if (taken > 0 && uart->rx_done_ns == UART_IDLE) {
        uart->rx_done_ns = now_ns + uart->byte_ns;
    }
    return taken;
}

size_t uart_host_read(uart_t *uart, uint8_t *data, size_t room)
{
    size_t taken = 0;
    while (taken < room && uart->tx_size > 0) {
        data[taken++] = uart->tx_line[uart->tx_head];
        uart->tx_head = (uart->tx_head + 1) % UART_TX_LINE;
        uart->tx_size--;
    }
    return taken;
}

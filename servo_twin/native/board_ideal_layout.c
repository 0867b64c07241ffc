/* Layout of the board with the ideal chip, for board_state.c. */
#include "board_ideal.h"
#include "board_pointers.h"

#define UART(member) offsetof(struct board, chip.uart.member)

static const board_gap_t gaps[] = {
    {UART(rx_line), UART_RX_LINE, UART(rx_head), UART(rx_size)},
    {UART(tx_line), UART_TX_LINE, UART(tx_head), UART(tx_size)},
};

const board_layout_t board_layout = {
    .size = sizeof(struct board),
    .pointer = board_pointers,
    .pointers = sizeof board_pointers / sizeof board_pointers[0],
    .gap = gaps,
    .gaps = sizeof gaps / sizeof gaps[0],
    .build = BOARD_BUILD,
};

/* Between two calls the board is nothing but data. */
const char *board_rest(board_t *board)
{
    (void)board;
    return NULL;
}

void board_restored(board_t *board) { (void)board; }

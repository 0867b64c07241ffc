/* What is the same on both levels: the host's view of the variables. */
#include "board_parts.h"

#include "app/variables.h"

size_t board_snapshot_size(void) { return sizeof(snapshot_t); }

uint8_t board_read(board_t *board, uint32_t address, uint8_t *data, uint16_t size)
{
    return servo_read(board_servo(board), address, data, size);
}

uint8_t board_write(board_t *board, uint32_t address, const uint8_t *data, uint16_t size)
{
    return servo_write(board_servo(board), address, data, size);
}

void board_table(uint32_t *address, uint32_t *size)
{
    *address = TSA_TABLE_BASE;
    *size = tsa_table_size(&servo_variables);
}

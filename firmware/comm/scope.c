#include "comm/scope.h"

#include <stddef.h>

#include "comm/status.h"

#define OPERATION_RESET 0x01u
#define OPERATION_SLOT 0x02u

static void reset(scope_t *scope, uint8_t count)
{
    for (uint16_t i = 0; i < SCOPE_SLOTS; i++) {
        scope->slot[i].size = 0;
    }
    scope->count = count;
}

void scope_init(scope_t *scope) { reset(scope, 0); }

/* 01: u8 count. Bytes after it are ignored; a count that is too large keeps the old setup. */
static fm_status_t run_reset(scope_t *scope, payload_reader_t *operand)
{
    const uint8_t count = payload_get_u8(operand);
    if (operand->missing || count > SCOPE_SLOTS) {
        return FM_BAD_SIZE;
    }
    reset(scope, count);
    return FM_OK;
}

/* 02: u8 slot, ADDR, u8 size. Checked in the order of the vendor's server: slot, size, length, access. The address is
 * resolved here and not in every READSCOPE: the table is constant, and READSCOPE masks the control loops. */
static fm_status_t run_slot(scope_t *scope, const tsa_space_t *space, payload_reader_t *operand)
{
    const uint8_t slot = payload_get_u8(operand);
    if (!operand->missing && slot >= scope->count) {
        return FM_BAD_INDEX;
    }
    const uint32_t address = payload_get_unsigned(operand);
    const uint8_t size = payload_get_u8(operand);
    if (operand->missing || operand->remaining != 0 || !tsa_is_variable_size(size)) {
        return FM_BAD_SIZE;
    }
    return tsa_readable(space, address, size, &scope->slot[slot]) ? FM_OK : FM_DENIED;
}

fm_status_t scope_configure(scope_t *scope, const tsa_space_t *space, payload_reader_t *operations)
{
    fm_status_t status = FM_OK;
    payload_operation_t operation;
    while (!fm_is_error(status) && payload_next_operation(operations, &operation)) {
        switch (operation.code) {
        case OPERATION_RESET:
            status = run_reset(scope, &operation.operand);
            break;
        case OPERATION_SLOT:
            status = run_slot(scope, space, &operation.operand);
            break;
        default:
            status = FM_UNKNOWN_COMMAND;
            break;
        }
    }
    return operations->missing ? FM_BAD_SIZE : status;
}

fm_status_t scope_read(const scope_t *scope, const tsa_space_t *space, payload_writer_t *reply)
{
    if (scope->count == 0) {
        return FM_NOT_CONFIGURED;
    }
    for (uint16_t i = 0; i < scope->count; i++) {
        uint8_t *room = payload_reserve(reply, scope->slot[i].size);
        if (room == NULL) {
            return FM_ANSWER_TOO_LONG;
        }
        tsa_copy(space, &scope->slot[i], room);
    }
    return FM_OK;
}

#include "comm/app_command.h"

#include <stddef.h>
#include <string.h>

#include "comm/frame.h"
#include "comm/status.h"

void app_command_init(app_command_t *command)
{
    command->code = 0;
    command->status = APP_COMMAND_NONE;
    command->begun = false;
    command->arguments_size = 0;
    command->result_size = 0;
}

fm_status_t app_command_send(app_command_t *command, payload_reader_t *request)
{
    if (command->status == APP_COMMAND_PENDING) {
        return FM_BUSY;
    }
    const uint8_t code = payload_get_u8(request);
    if (request->missing) {
        return FM_BAD_SIZE;
    }
    if (code == APP_COMMAND_NONE) {
        return FM_UNKNOWN_COMMAND; /* the vendor's server accepts FF, and that command then stays pending */
    }
    const uint16_t size = request->remaining;
    if (size > APP_COMMAND_ARGUMENTS_MAX) {
        return FM_BAD_INDEX;
    }
    memcpy(command->arguments, request->data, size);
    command->arguments_size = size;
    command->code = code;
    command->result_size = 0;
    command->status = APP_COMMAND_PENDING;
    command->begun = false;
    return FM_OK;
}

static void finish(app_command_t *command, uint8_t code, uint16_t size)
{
    command->result_size = size <= APP_COMMAND_RESULT_MAX ? size : (uint16_t)APP_COMMAND_RESULT_MAX;
    command->status = code <= APP_COMMAND_CODE_MAX ? code : APP_COMMAND_CODE_MAX;
}

uint8_t app_command_poll(app_command_t *command, app_command_run_t run, void *context)
{
    if (command->status == APP_COMMAND_PENDING && !command->begun) {
        uint16_t size = APP_COMMAND_RESULT_MAX;
        command->begun = true;
        const uint8_t code =
            run(context, command->code, command->arguments, command->arguments_size, command->result, &size);
        if (code != APP_COMMAND_PENDING) {
            finish(command, code, size);
        }
    }
    return command->status;
}

void app_command_finish(app_command_t *command, uint8_t code, const uint8_t *result, uint16_t size)
{
    if (command->status == APP_COMMAND_PENDING && command->begun) {
        finish(command, code, size);
        memcpy(command->result, result, command->result_size);
    }
}

fm_status_t app_command_data(const app_command_t *command, payload_reader_t *request, payload_writer_t *reply)
{
    const uint32_t size = payload_get_unsigned(request);
    const uint32_t offset = payload_get_unsigned(request);
    if (command->status == APP_COMMAND_PENDING) {
        return FM_BUSY;
    }
    if (request->missing) {
        return FM_BAD_SIZE;
    }
    if (size > FRAME_MTU) {
        return FM_ANSWER_TOO_LONG;
    }
    /* Only results of this command may be read: the rest of the buffer holds data of earlier ones. */
    if (size == 0 || offset > command->result_size || size > command->result_size - offset) {
        return FM_BAD_SIZE;
    }
    payload_put_bytes(reply, command->result + (size_t)offset, (uint16_t)size);
    return FM_OK_VARIABLE;
}

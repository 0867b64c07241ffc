/* app_command.h - application commands: sent, carried out, and read back in three separate requests.
 *
 * A command is stored by SENDAPPCMD and runs inside the first GETAPPCMDSTS. So a client whose answer got lost may
 * repeat either request without having the command carried out twice. The application may also begin there and finish
 * later: until then the command is pending, and no other one is taken.
 */
#ifndef COMM_APP_COMMAND_H
#define COMM_APP_COMMAND_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/payload.h"

#define APP_COMMAND_ARGUMENTS_MAX 32
#define APP_COMMAND_RESULT_MAX 32

#define APP_COMMAND_PENDING UINT8_C(0xFE)  /* sent, or begun, not carried out yet */
#define APP_COMMAND_NONE UINT8_C(0xFF)     /* none since start */
#define APP_COMMAND_CODE_MAX UINT8_C(0xF7) /* largest result of an application; F8..FF are reserved */

/* Carry out `code`; `result_size` comes in with the room in `result` and goes out with the bytes stored. Returns the
 * application's result code; or APP_COMMAND_PENDING, and the application calls app_command_finish when it is done. */
typedef uint8_t (*app_command_run_t)(void *context, uint8_t code, const uint8_t *arguments, uint16_t size,
                                     uint8_t *result, uint16_t *result_size);

typedef struct {
    uint8_t code; /* of the application's command */
    uint8_t status; /* APP_COMMAND_PENDING, APP_COMMAND_NONE or the result code */
    bool begun;     /* the application has it */
    uint16_t arguments_size; /* bytes */
    uint16_t result_size; /* bytes */
    uint8_t arguments[APP_COMMAND_ARGUMENTS_MAX]; /* as received */
    uint8_t result[APP_COMMAND_RESULT_MAX]; /* as answered */
} app_command_t;

void app_command_init(app_command_t *command);

/* SENDAPPCMD: u8 code, arguments. */
uint8_t app_command_send(app_command_t *command, payload_reader_t *request);

/* GETAPPCMDSTS: begin a command that was sent; returns the byte to answer. */
uint8_t app_command_poll(app_command_t *command, app_command_run_t run, void *context);

/* The command that the application has begun is done, with this result code and these data, of which those fit that
 * APP_COMMAND_RESULT_MAX allows. Nothing happens when none is under way. */
void app_command_finish(app_command_t *command, uint8_t code, const uint8_t *result, uint16_t size);

/* GETAPPCMDDATA: SIZE n, SIZE offset. */
uint8_t app_command_data(const app_command_t *command, payload_reader_t *request, payload_writer_t *reply);

#endif

/* app_command.h - application commands: transmission, execution and result in three separate requests.
 *
 * SENDAPPCMD stores a command, the first GETAPPCMDSTS executes it. Both requests can be repeated after a lost answer
 * without a second execution. The application may finish a command later; until then it is pending and no other command
 * is accepted.
 */
#ifndef COMM_APP_COMMAND_H
#define COMM_APP_COMMAND_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/payload.h"
#include "comm/status.h"

#define APP_COMMAND_ARGUMENTS_MAX 32
#define APP_COMMAND_RESULT_MAX 32

#define APP_COMMAND_PENDING UINT8_C(0xFE)  /* sent or begun, not finished */
#define APP_COMMAND_NONE UINT8_C(0xFF)     /* no command since reset */
#define APP_COMMAND_CODE_MAX UINT8_C(0xF7) /* largest result code of an application; F8..FF are reserved */

/* Execute `code`. `result_size`: on entry the size of `result`, on return the number of stored bytes. Returns the
 * result code, or APP_COMMAND_PENDING; then the application calls app_command_finish later. */
typedef uint8_t (*app_command_run_t)(void *context, uint8_t code, const uint8_t *arguments, uint16_t size,
                                     uint8_t *result, uint16_t *result_size);

typedef struct {
    uint8_t code; /* code of the command */
    uint8_t status; /* APP_COMMAND_PENDING, APP_COMMAND_NONE or the result code */
    bool begun; /* the application has begun the execution */
    uint16_t arguments_size; /* size of the arguments, bytes */
    uint16_t result_size; /* size of the result, bytes */
    uint8_t arguments[APP_COMMAND_ARGUMENTS_MAX]; /* received arguments */
    uint8_t result[APP_COMMAND_RESULT_MAX]; /* result data */
} app_command_t;

void app_command_init(app_command_t *command);

/* SENDAPPCMD: u8 code, arguments. */
fm_status_t app_command_send(app_command_t *command, payload_reader_t *request);

/* GETAPPCMDSTS: execute a stored command; returns the status byte of the answer. */
uint8_t app_command_poll(app_command_t *command, app_command_run_t run, void *context);

/* Finish a pending command with a result code and data, truncated to APP_COMMAND_RESULT_MAX bytes. No effect if no
 * command is pending. */
void app_command_finish(app_command_t *command, uint8_t code, const uint8_t *result, uint16_t size);

/* GETAPPCMDDATA: SIZE n, SIZE offset. */
fm_status_t app_command_data(const app_command_t *command, payload_reader_t *request, payload_writer_t *reply);

#endif

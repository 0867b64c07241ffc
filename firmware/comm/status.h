/* status.h - status byte of a FreeMASTER answer.
 *
 * Bit 7: error, no data follow. Bit 6: a length byte follows. Neither: the length is known from the request.
 */
#ifndef COMM_STATUS_H
#define COMM_STATUS_H

#include <stdbool.h>
#include <stdint.h>

typedef uint8_t fm_status_t; /* one of the FM_ codes below */

#define FM_OK UINT8_C(0x00)               /* success; length of the data known from the request */
#define FM_OK_VARIABLE UINT8_C(0x40)      /* success, a length byte follows */
#define FM_UNKNOWN_COMMAND UINT8_C(0x81)  /* unknown command, or feature or sub-operation not implemented */
#define FM_BAD_CHECKSUM UINT8_C(0x82)
#define FM_REQUEST_TOO_LONG UINT8_C(0x83)
#define FM_ANSWER_TOO_LONG UINT8_C(0x84)
#define FM_BAD_INDEX UINT8_C(0x85)        /* slot out of range, or too many arguments */
#define FM_BAD_SIZE UINT8_C(0x86)         /* wrong length of payload or operand */
#define FM_BUSY UINT8_C(0x87)
#define FM_NOT_CONFIGURED UINT8_C(0x88)
#define FM_DENIED UINT8_C(0x89)           /* not in the variable table, or unknown configuration key */
#define FM_PIPE UINT8_C(0x8C)           /* unknown pipe, or not a pipe request */
#define FM_NO_FLOAT UINT8_C(0x90)         /* no triggers on floating-point numbers */
#define FM_PASSWORD_NEEDED UINT8_C(0x91)
#define FM_PASSWORD_WRONG UINT8_C(0x92)
#define FM_BAD_INSTANCE UINT8_C(0x94)     /* unknown scope, recorder, or slot */
#define FM_BAD_OPERATION UINT8_C(0x95)    /* unknown operation of a recorder */
#define FM_OUT_OF_RANGE UINT8_C(0x97) /* value outside the range of its variable, refused by the application */

static inline bool fm_is_error(fm_status_t status) { return (status & 0x80u) != 0; }

#endif

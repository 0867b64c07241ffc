/* exchange.h - inputs and outputs through hal/hal.h during one call of an entry point, as 16-bit words.
 *
 * Words in are the values read by the core, in the order of the reads. Words out are its operations on the board: a
 * head (operation | axis << 8) and the operands. The recorder stores both on a running board; the replay board returns
 * the words in and stores the words out.
 */
#ifndef TARGETS_EXCHANGE_H
#define TARGETS_EXCHANGE_H

#include <stdbool.h>
#include <stdint.h>

typedef enum {
    CALL_INIT,
    CALL_M1,
    CALL_M2,
    CALL_BACKGROUND,
    CALL_EDGE,
    CALL_OVER_CURRENT,
    CALL_END, /* of the recording */
} call_t;

typedef enum {
    OUT_SELECT, /* pair */
    OUT_DUTY,   /* a, b, c */
    OUT_ENABLE, /* on */
    OUT_OVER_CURRENT_CLEAR,
    OUT_PRESET, /* count */
    OUT_ARM,
    OUT_SERIAL, /* byte */
    OUT_WATCHDOG,
    OUT_BRAKE,   /* on */
    OUT_MONITOR, /* value */
    OUT_ENABLE_INPUT, /* used */
    OUT_HOLDING, /* release */
    OUT_DONE,    /* the fast loop has ended */
    OUT_ERASE,   /* sector */
    OUT_PROGRAM, /* word, value: low half, high half */
    OUT_ENCODER_START, /* period */
} out_t;

#define EXCHANGE_IN_MAX 64
#define EXCHANGE_OUT_MAX 96

/* Words out of one call. Words beyond the buffer are discarded but counted, so the digest depends on them. */
typedef struct {
    uint16_t word[EXCHANGE_OUT_MAX];
    uint16_t size;
} out_log_t;

static inline void out_word(out_log_t *log, uint16_t word)
{
    if (log->size < EXCHANGE_OUT_MAX) {
        log->word[log->size] = word;
    }
    log->size++;
}

static inline void out_head(out_log_t *log, out_t operation, uint16_t axis)
{
    out_word(log, (uint16_t)((uint16_t)operation | (uint16_t)(axis << 8)));
}

#endif

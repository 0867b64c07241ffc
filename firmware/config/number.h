/* number.h - an integer in memory, by its kind, and the range of its values. */
#ifndef SERVO_CONFIG_NUMBER_H
#define SERVO_CONFIG_NUMBER_H

#include <stdbool.h>
#include <stdint.h>

#define NUMBER_WIDE 1U   /* 32 bits; otherwise 16 */
#define NUMBER_SIGNED 2U
#define NUMBER_BITS 4U   /* set of bits: `max` of the range has all permitted bits */
#define NUMBER_LIVE 8U   /* of a configuration block: may change in motion */

/* Range of a number. All values within it fit int32_t. */
typedef struct {
    uint16_t kind; /* NUMBER_ bits */
    int32_t min; /* smallest raw value */
    int32_t max; /* largest raw value */
} number_range_t;

/* A number in memory. */
typedef struct {
    void *at;
    number_range_t range;
} number_t;

/* Bytes of a number. */
static inline uint16_t number_size(uint16_t kind) { return (kind & NUMBER_WIDE) != 0U ? 4U : 2U; }

/* Value of the lowest bits of `bits`. */
static inline int32_t number_of(uint32_t bits, uint16_t kind)
{
    if ((kind & NUMBER_WIDE) != 0U) {
        return (int32_t)bits;
    }
    return (kind & NUMBER_SIGNED) != 0U ? (int16_t)bits : (int32_t)(bits & UINT32_C(0xFFFF));
}

static inline int32_t number_get(const void *at, uint16_t kind)
{
    return number_of((kind & NUMBER_WIDE) != 0U ? *(const uint32_t *)at : *(const uint16_t *)at, kind);
}

static inline void number_set(void *at, uint16_t kind, int32_t value)
{
    if ((kind & NUMBER_WIDE) != 0U) {
        *(uint32_t *)at = (uint32_t)value;
    } else {
        *(uint16_t *)at = (uint16_t)value;
    }
}

static inline bool number_accepts(const number_range_t *range, int32_t value)
{
    const bool bits = (range->kind & NUMBER_BITS) == 0U || ((uint32_t)value & ~(uint32_t)range->max) == 0U;
    return value >= range->min && value <= range->max && bits;
}

#endif

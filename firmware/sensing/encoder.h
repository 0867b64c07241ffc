/* encoder.h - position from the quadrature counter and the emulated index (DRM 2.4.1, 2.4.2, 2.7.2; F12..F14, E41).
 *
 * The counter reloads once per turn. A turn of an encoder of more than 8192 lines does not fit its 16 bits with sign:
 * there it reloads twice per turn, and the emulated index counts half turns.
 */
#ifndef SERVO_SENSING_ENCODER_H
#define SERVO_SENSING_ENCODER_H

#include "math/frac.h"

#define ENCODER_ANGLE_MIN UINT32_C(131072) /* angle_per_count of 8192 lines */

typedef struct {
    uint16_t counts; /* from one reload of the counter to the next, at most 32768 */
    uint16_t pole_pairs; /* electrical turns per mechanical turn */
    uint32_t angle_per_count; /* 2^32 / counts per turn: 16.38 of F12 with 16 additional fraction bits */
} encoder_config_t;

typedef struct {
    uint16_t count; /* ENC(k-1): counter of the previous slow loop, counts */
    uint16_t index; /* REV(k-1): index pulses at the previous slow loop */
    uint16_t pending; /* index pulses not yet confirmed by a wrap of the counter */
    uint16_t half_turns; /* reloads since the counter was preset; only the lowest bit is used, with two per turn */
    int32_t turns; /* RealZCnt: reloads, with up to 8192 lines mechanical turns */
    int32_t count_init; /* EncCntInit: offset, counts */
    int32_t position; /* counts since the first rotor search (E41) */
    int32_t integral; /* sum of wrapped differences, counts; cross-check of `position` */
} encoder_t;

/* Position in the counts of the contract, POSITION_PER_TURN to a turn of any encoder. The remainder is kept, so that no
 * error adds up. */
typedef struct {
    int32_t whole; /* nearest position count, modulo 2^32 */
    int16_t rest; /* position minus `whole`, in parts of a position count, of which there are as many as lines */
    uint16_t lines; /* of the encoder, per turn */
} encoder_position_t;

static inline bool encoder_reloads_twice(const encoder_config_t *config)
{
    return config->angle_per_count < ENCODER_ANGLE_MIN;
}

/* Lines per turn: a quarter of the counts. */
static inline uint16_t encoder_lines(const encoder_config_t *config)
{
    return (uint16_t)(config->counts / (encoder_reloads_twice(config) ? 2U : 4U));
}

/* Mechanical angle, 2^32 is one turn. The counter is a two's complement number; its product with 2^32 / counts wraps
 * like the angle, as F12 requires of the 16-bit product without saturation. */
static inline uint32_t encoder_angle32(const encoder_config_t *config, uint16_t count)
{
    return (uint32_t)(int32_t)(int16_t)count * config->angle_per_count;
}

/* The half turn in which the counter is: 0 or 2^31. A jump of the counter since the last slow loop is a reload. */
static inline uint32_t encoder_half_turn(const encoder_t *encoder, const encoder_config_t *config, uint16_t count)
{
    const int32_t moved = (int32_t)(int16_t)count - (int16_t)encoder->count;
    const uint32_t reloaded = ((uint32_t)(moved + config->counts / 2) > config->counts) ? 1U : 0U;
    return ((uint32_t)encoder->half_turns + reloaded) << 31;
}

static inline frac16_t encoder_upper_half(uint32_t angle)
{
    return (frac16_t)(uint16_t)((angle + UINT32_C(0x8000)) >> 16);
}

/* Mechanical angle of a counter value since its last reload; error at most 1 LSB in both directions (F12). */
static inline frac16_t encoder_theta_m(const encoder_config_t *config, uint16_t count)
{
    return encoder_upper_half(encoder_angle32(config, count));
}

/* Electrical angle, in the fast loop. */
static inline frac16_t encoder_theta_e(const encoder_t *encoder, const encoder_config_t *config, uint16_t count)
{
    uint32_t angle = encoder_angle32(config, count);
    if (encoder_reloads_twice(config)) {
        angle += encoder_half_turn(encoder, config, count);
    }
    return encoder_upper_half(angle * config->pole_pairs);
}

/* Counter value of an electrical angle, within half an electrical turn of zero. */
int16_t encoder_count_at(const encoder_config_t *config, frac16_t theta_e);

/* Difference of two counter values, wrapped to half a period; range of both: -period+1 .. period-1. */
int16_t encoder_difference(const encoder_config_t *config, uint16_t count, uint16_t previous);

void encoder_reset(encoder_t *encoder, uint16_t count, uint16_t index);

/* One slow loop. False if the index pulses and the count give different numbers of turns. */
bool encoder_update(encoder_t *encoder, const encoder_config_t *config, uint16_t count, uint16_t index);

/* After a contradiction: continue with the sum of wrapped differences, which needs no index. */
void encoder_resync(encoder_t *encoder, const encoder_config_t *config);

/* After a preset of the counter to `count`: keep the position. */
void encoder_preset(encoder_t *encoder, const encoder_config_t *config, uint16_t count);

/* Add a number of encoder counts, at most 32768. */
void encoder_position_add(encoder_position_t *position, const encoder_config_t *config, int16_t counts);

/* Position minus the nearest position count, of a position count, 24 fraction bits. */
static inline int32_t encoder_position_part(const encoder_position_t *position, const encoder_config_t *config)
{
    const uint32_t part = (uint32_t)(int32_t)position->rest * config->angle_per_count; /* about half of 2^30 at most */
    return asr32((int32_t)part, 30 - 24);
}

#endif

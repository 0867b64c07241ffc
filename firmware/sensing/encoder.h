/* encoder.h - position from the quadrature counter and the emulated index (DRM 2.4.1, 2.4.2, 2.7.2; F12..F14, E41). */
#ifndef SERVO_SENSING_ENCODER_H
#define SERVO_SENSING_ENCODER_H

#include "math/frac.h"

typedef struct {
    uint16_t counts;          /* counts per turn: 4 x lines */
    uint16_t pole_pairs; /* electrical turns per mechanical turn */
    uint32_t angle_per_count; /* 2^32 / counts: 16.38 of F12 with 16 additional fraction bits */
} encoder_config_t;

typedef struct {
    uint16_t count; /* ENC(k-1): counter of the previous slow loop, counts */
    uint16_t index; /* REV(k-1): index pulses at the previous slow loop */
    uint16_t pending; /* index pulses not yet confirmed by a wrap of the counter */
    int32_t turns; /* RealZCnt: mechanical turns */
    int32_t count_init; /* EncCntInit: offset, counts */
    int32_t position; /* counts since the first rotor search (E41) */
    int32_t integral; /* sum of wrapped differences, counts; cross-check of `position` */
} encoder_t;

/* Mechanical angle, 2^32 is one turn. The counter is a two's complement number; its product with 2^32 / counts wraps
 * like the angle, as F12 requires of the 16-bit product without saturation. */
static inline uint32_t encoder_angle32(const encoder_config_t *config, uint16_t count)
{
    return (uint32_t)(int32_t)(int16_t)count * config->angle_per_count;
}

static inline frac16_t encoder_upper_half(uint32_t angle)
{
    return (frac16_t)(uint16_t)((angle + UINT32_C(0x8000)) >> 16);
}

/* Mechanical and electrical angle of a counter value; error at most 1 LSB in both directions (F12). */
static inline frac16_t encoder_theta_m(const encoder_config_t *config, uint16_t count)
{
    return encoder_upper_half(encoder_angle32(config, count));
}

static inline frac16_t encoder_theta_e(const encoder_config_t *config, uint16_t count)
{
    return encoder_upper_half(encoder_angle32(config, count) * config->pole_pairs);
}

/* Counter value of an electrical angle, within half an electrical turn of zero. */
int16_t encoder_count_at(const encoder_config_t *config, frac16_t theta_e);

/* Difference of two counter values, wrapped to half a turn; range of both: -counts+1 .. counts-1. */
int16_t encoder_difference(const encoder_config_t *config, uint16_t count, uint16_t previous);

void encoder_reset(encoder_t *encoder, uint16_t count, uint16_t index);

/* One slow loop. False if the index pulses and the count give different numbers of turns. */
bool encoder_update(encoder_t *encoder, const encoder_config_t *config, uint16_t count, uint16_t index);

/* After a contradiction: continue with the sum of wrapped differences, which needs no index. */
void encoder_resync(encoder_t *encoder, const encoder_config_t *config);

/* After a preset of the counter to `count`: keep the position. */
void encoder_preset(encoder_t *encoder, const encoder_config_t *config, uint16_t count);

#endif

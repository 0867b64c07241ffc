/* encoder.h - position from the quadrature counter and the emulated index (DRM 2.4.1, 2.4.2, 2.7.2; F12..F14, E41). */
#ifndef SERVO_SENSING_ENCODER_H
#define SERVO_SENSING_ENCODER_H

#include "math/frac.h"

typedef struct {
    uint16_t counts;          /* per turn: 4 x lines */
    uint16_t pole_pairs; /* electrical turns per mechanical turn */
    uint32_t angle_per_count; /* 2^32 / counts: F12's 16.38 with 16 more fraction bits */
} encoder_config_t;

typedef struct {
    uint16_t count;     /* ENC(k-1) */
    uint16_t index;     /* REV(k-1) */
    uint16_t pending;   /* index pulses that no wrap has confirmed yet */
    int32_t turns;      /* RealZCnt */
    int32_t count_init; /* EncCntInit */
    int32_t position;   /* counts since the rotor was first found (E41) */
    int32_t integral;   /* the same, from wrapped differences: the cross-check */
} encoder_t;

/* Angle over the full 32-bit turn. The counter is a two's complement number; its product with 2^32 / counts wraps as
 * the angle does, which is what F12 requires from the 16-bit product without saturation. */
static inline uint32_t encoder_angle32(const encoder_config_t *config, uint16_t count)
{
    return (uint32_t)(int32_t)(int16_t)count * config->angle_per_count;
}

static inline frac16_t encoder_upper_half(uint32_t angle)
{
    return (frac16_t)(uint16_t)((angle + UINT32_C(0x8000)) >> 16);
}

/* Angles of a counter value; at most 1 LSB off over both directions (F12). */
static inline frac16_t encoder_theta_m(const encoder_config_t *config, uint16_t count)
{
    return encoder_upper_half(encoder_angle32(config, count));
}

static inline frac16_t encoder_theta_e(const encoder_config_t *config, uint16_t count)
{
    return encoder_upper_half(encoder_angle32(config, count) * config->pole_pairs);
}

/* Counter value that reads as an electrical angle, within half an electrical turn of zero. */
int16_t encoder_count_at(const encoder_config_t *config, frac16_t theta_e);

/* Difference of two counter values, wrapped to half a turn; both count -counts+1 .. counts-1. */
int16_t encoder_difference(const encoder_config_t *config, uint16_t count, uint16_t previous);

void encoder_reset(encoder_t *encoder, uint16_t count, uint16_t index);

/* One slow loop. False when the index pulses and the count disagree about the turns. */
bool encoder_update(encoder_t *encoder, const encoder_config_t *config, uint16_t count, uint16_t index);

/* After a disagreement: take the wrapped differences, which need no index. */
void encoder_resync(encoder_t *encoder, const encoder_config_t *config);

/* The counter has been preset to `count`: the position stays what it was. */
void encoder_preset(encoder_t *encoder, const encoder_config_t *config, uint16_t count);

#endif

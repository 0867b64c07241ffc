#include "control/torque_ripple.h"

#include "math/trig.h"

#define FADE_END INT32_C(0x4000) /* a quarter turn, 2^16 is one turn */
#define FADE_BITS 2              /* from an eighth to a quarter of a turn: 2^13 to 2^15 */
#define ONE INT32_C(32768)       /* 15 fraction bits */

/* Part of a harmonic whose phase the extrapolation advances by `order` times `advance`, 15 fraction bits. */
static int32_t part_of(uint16_t order, uint16_t advance)
{
    const uint32_t phase = (uint32_t)order * advance;
    if (phase >= (uint32_t)FADE_END) {
        return 0;
    }
    const int32_t part = (FADE_END - (int32_t)phase) * (1 << FADE_BITS);
    return (part > ONE) ? ONE : part;
}

frac32_t torque_ripple_current(const torque_ripple_config_t *config, uint32_t angle, frac32_t speed)
{
    const int32_t ahead = (int32_t)asr64((int64_t)speed * config->lead, 31); /* 2^31 is one turn */
    const uint32_t at = angle + ((uint32_t)ahead << 1);
    const uint16_t advance = (uint16_t)((uint32_t)f32_abs(ahead) >> 15);
    int64_t sum = 0;
    for (uint16_t i = 0; i < RIPPLE_HARMONICS && config->order[i] != 0U; i++) {
        const uint16_t order = config->order[i];
        const uint16_t phase = (uint16_t)((((uint32_t)order * at) >> 16) + config->phase[i]);
        const int32_t amplitude = asr32(config->amplitude[i] * part_of(order, advance), 14); /* Q1.16 */
        sum += (int64_t)amplitude * f16_sin((frac16_t)phase);
    }
    return sat32(sum);
}

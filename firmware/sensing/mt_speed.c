#include "sensing/mt_speed.h"

/* Two 32-bit divisions instead of a 64-bit one, which takes hundreds of instructions. */

/* counts x factor / interval as a fraction with 31 bits. */
static frac32_t ratio(int16_t counts, uint32_t factor, uint16_t interval)
{
    const uint32_t magnitude = (uint32_t)((counts < 0) ? -(int32_t)counts : (int32_t)counts);
    const uint64_t product = (uint64_t)magnitude * factor;
    const uint32_t scaled = (uint32_t)(product & UINT32_C(0xFFFFFFFF));
    const uint32_t whole = scaled / interval;
    if (product > UINT32_C(0xFFFFFFFF) || whole > UINT32_C(0xFFFF)) {
        return (counts < 0) ? FRAC32_MIN : FRAC32_MAX;
    }
    const uint32_t part = ((scaled % interval) << 15) / interval;
    const int32_t result = (int32_t)((whole << 15) | part);
    return (counts < 0) ? -result : result;
}

/* speed x interval / age, towards zero; the age is larger than the interval and has no more than 16 bits. */
static frac32_t stretched(frac32_t speed, uint16_t interval, uint32_t age)
{
    const uint32_t magnitude = (speed < 0) ? UINT32_C(0) - (uint32_t)speed : (uint32_t)speed;
    const uint64_t product = (uint64_t)magnitude * interval;
    const uint32_t upper = (uint32_t)(product >> 16);
    const uint32_t lower = (upper % age) << 16 | (uint32_t)(product & UINT32_C(0xFFFF));
    const int32_t result = (int32_t)(((upper / age) << 16) + lower / age);
    return (speed < 0) ? -result : result;
}

void mt_speed_reset(mt_speed_t *mt)
{
    mt->last.count = 0;
    mt->last.time = 0;
    mt->primed = false;
    mt->fresh = false;
    mt->interval = 0;
    mt->waited = 0;
    mt->edge_speed = 0;
    mt->speed = 0;
}

void mt_speed_edge(mt_speed_t *mt, const mt_speed_config_t *config, const encoder_config_t *encoder,
                   edge_capture_t capture)
{
    const uint16_t interval = (uint16_t)(capture.time - mt->last.time);
    if (mt->primed && interval != 0U && interval >= mt->waited) {
        const int16_t counts = encoder_difference(encoder, capture.count, mt->last.count);
        mt->edge_speed = ratio(counts, config->speed_per_ratio, interval);
        mt->interval = interval;
    } else {
        mt->edge_speed = 0; /* no earlier edge, or the 16-bit timer has overflowed since: nearly at standstill */
    }
    mt->waited = 0;
    mt->last = capture;
    mt->primed = true;
    mt->fresh = true;
    mt->speed = mt->edge_speed;
}

void mt_speed_slow(mt_speed_t *mt, uint32_t age, bool enhanced)
{
    if (mt->fresh) {
        mt->fresh = false; /* measured within this loop: not stagnant */
        return;
    }
    mt->waited = age;
    if (age >= HAL_EDGE_AGE_OVERFLOW) {
        /* No edge within 16 bits: standstill. The next edge starts a new measurement, because its interval would be
         * ambiguous. */
        mt->primed = false;
        mt->edge_speed = 0;
        mt->speed = 0;
    } else if (enhanced && age > mt->interval) {
        /* F19: at constant speed an edge would have come after M2, so the speed is reduced. */
        mt->speed = stretched(mt->edge_speed, mt->interval, age);
    }
}

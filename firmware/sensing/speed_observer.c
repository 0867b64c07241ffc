#include "sensing/speed_observer.h"

#define COUNT (INT32_C(1) << SPEED_OBSERVER_BITS)
#define PART_SHIFT (24 - SPEED_OBSERVER_BITS)
#define LOST (64 * COUNT) /* an estimate with this error no longer follows the shaft */

static frac32_t speed_of(const speed_observer_t *observer, const speed_observer_config_t *config)
{
    return sat32(asr64((int64_t)observer->step * config->speed_per_step, SPEED_OBSERVER_BITS));
}

void speed_observer_reset(speed_observer_t *observer, const speed_observer_config_t *config, int32_t count,
                          int32_t part, frac32_t speed)
{
    observer->count = count;
    observer->part = part;
    observer->offset = 0;
    observer->step = sat32(asr64((int64_t)speed * config->step_per_speed, 31 + 16 - SPEED_OBSERVER_BITS));
    observer->acceleration = 0;
}

/* Distance of the estimate from the interval of the measured count: the shaft may be anywhere within that count. */
static int32_t outside(int32_t offset, int32_t half_count)
{
    if (offset > half_count) {
        return half_count - offset;
    }
    return (offset < -half_count) ? -half_count - offset : 0;
}

static int64_t driven_by(const speed_observer_config_t *config, frac16_t i_q)
{
    return asr64((int64_t)f32_from_f16(i_q) * config->acceleration_per_current, 31);
}

void speed_observer_retune(speed_observer_t *observer, const speed_observer_config_t *before,
                           const speed_observer_config_t *config, frac16_t i_q)
{
    observer->acceleration = sat32(observer->acceleration + driven_by(before, i_q) - driven_by(config, i_q));
}

frac32_t speed_observer_step(speed_observer_t *observer, const speed_observer_config_t *config, int32_t count,
                             int32_t part, frac16_t i_q)
{
    const int64_t acceleration = driven_by(config, i_q) + observer->acceleration;
    const int64_t moved = (int64_t)i32_sub_wrap(count, observer->count) * COUNT + asr32(part, PART_SHIFT) -
                          asr32(observer->part, PART_SHIFT);
    observer->count = count;
    observer->part = part;
    observer->offset = sat32((int64_t)observer->offset + observer->step + asr64(acceleration, 1) - moved);
    observer->step = sat32(observer->step + acceleration);

    const int32_t error = outside(observer->offset, observer->half_count);
    if (error > LOST || error < -LOST) {
        const int64_t speed = asr64((int64_t)sat32(moved) * config->speed_per_step, SPEED_OBSERVER_BITS);
        speed_observer_reset(observer, config, count, part, sat32(speed));
    } else if (error != 0) {
        observer->offset += f32_gain(error, config->l_position);
        observer->step = f32_add(observer->step, f32_gain(error, config->l_speed));
        observer->acceleration = f32_add(observer->acceleration, f32_gain(error, config->l_acceleration));
    }
    return speed_of(observer, config);
}

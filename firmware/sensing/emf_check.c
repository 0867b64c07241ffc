#include "sensing/emf_check.h"

#define FILTER_SHIFT 5
#define FILTER_BITS 8

void emf_check_reset(emf_check_t *check) { *check = (emf_check_t){0}; }

bool emf_check_deviates(const emf_check_config_t *config, frac16_t floor, dq_t deviation, frac16_t expected,
                        frac16_t current)
{
    const int32_t by_resistance = asr32(f32_gain(f32_from_f16(f16_abs(current)), config->resistance), 16);
    const int32_t by_size = asr32(f16_abs(expected) * (int32_t)config->part, 15);
    return length_about(deviation.d, deviation.q) > floor + by_resistance + by_size;
}

static frac16_t smoothed(int32_t *state, frac16_t x)
{
    *state += asr32(x * (INT32_C(1) << FILTER_BITS) - *state, FILTER_SHIFT);
    return sat16_asr(*state, FILTER_BITS);
}

dq_t emf_check_filter(emf_check_t *check, dq_t deviation)
{
    return (dq_t){smoothed(&check->d, deviation.d), smoothed(&check->q, deviation.q)};
}

bool emf_check_emf_missing(const emf_check_t *check, const emf_check_config_t *config, frac16_t expected)
{
    const dq_t deviation = {sat16_asr(check->d, FILTER_BITS), sat16_asr(check->q, FILTER_BITS)};
    return emf_check_deviates(config, 0, deviation, expected, 0);
}

bool emf_check_confirmed(emf_check_t *check, bool deviates, uint16_t max)
{
    if (deviates) {
        check->ticks++;
    } else if (check->ticks > 0U) {
        check->ticks--;
    }
    return check->ticks > max;
}

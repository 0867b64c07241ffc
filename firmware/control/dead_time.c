#include "control/dead_time.h"

#define FULL INT32_C(32767)

static frac16_t compensate(frac16_t duty, frac16_t current, frac16_t loss, gain_t slope)
{
    /* A leg at 0 or 100 % does not switch and has no dead time; its drop cannot be made up either. */
    if (duty <= 0 || duty >= FULL) {
        return duty;
    }
    const frac16_t sign = f16_from_f32(f32_gain(f32_from_f16(current), slope));
    const int32_t corrected = (int32_t)duty + f16_mul(loss, sign);
    if (corrected < 0) {
        return 0;
    }
    return (corrected > FULL) ? (frac16_t)FULL : (frac16_t)corrected;
}

abc_t dead_time_compensate(const dead_time_config_t *config, abc_t duty, abc_t current, int32_t reciprocal)
{
    const frac16_t drop = sat16(asr32(config->v_drop * reciprocal + INT32_C(0x2000), 14));
    const frac16_t loss = f16_add(config->duty, drop);
    return (abc_t){
        compensate(duty.a, current.a, loss, config->slope),
        compensate(duty.b, current.b, loss, config->slope),
        compensate(duty.c, current.c, loss, config->slope),
    };
}

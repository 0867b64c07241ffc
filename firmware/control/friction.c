#include "control/friction.h"

#define ONE INT32_C(32768) /* 15 fraction bits */

/* s(|speed| / smooth), 15 fraction bits. */
static int32_t smooth_step(const friction_config_t *config, frac32_t magnitude)
{
    if (magnitude >= config->smooth) {
        return ONE;
    }
    const int32_t x = sat16((int32_t)asr64((int64_t)magnitude * config->slope, 32));
    return asr32(x * (3 * ONE - asr32(x * x, 15)), 16); /* just below 2^31 at x = 32767 */
}

frac32_t friction_current(const friction_config_t *config, frac32_t speed)
{
    const int64_t coulomb = asr64((int64_t)config->coulomb * smooth_step(config, f32_abs(speed)), 15);
    return sat32(f32_gain(speed, config->viscous) + ((speed < 0) ? -coulomb : coulomb));
}

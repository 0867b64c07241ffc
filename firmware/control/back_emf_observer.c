#include "control/back_emf_observer.h"

#define TWO_PI_Q28 INT32_C(1686629713)
#define STEP_MAX INT32_C(170000000) /* a quarter of a radian: the series below is accurate to 5e-6 */

void back_emf_observer_reset(back_emf_observer_t *observer, const back_emf_observer_config_t *config, ab_t current)
{
    *observer = (back_emf_observer_t){0};
    observer->i.alpha = current.alpha * (INT32_C(1) << config->f1);
    observer->i.beta = current.beta * (INT32_C(1) << config->f1);
}

void back_emf_observer_set_speed(back_emf_observer_t *observer, int32_t step)
{
    const int32_t x = (int32_t)asr64((int64_t)f32_clip(step, STEP_MAX) * TWO_PI_Q28, 28); /* rad, 32 fraction bits */
    /* sin x is about x - x^3 / 6, 1 - cos x about x^2 / 2 - x^4 / 24 */
    const int32_t square = back_emf_observer_upper(x, x);
    const int32_t fourth = back_emf_observer_upper(square, square);
    observer->rotation_sin = x - back_emf_observer_upper(x, square) / 6;
    observer->rotation_versine = square / 2 - fourth / 24;
}

ab_t back_emf_observer_emf(const back_emf_observer_t *observer, const back_emf_observer_config_t *config)
{
    const ab_t result = {
        sat16(asr32(observer->e.alpha, config->f2)),
        sat16(asr32(observer->e.beta, config->f2)),
    };
    return result;
}

#include "control/pll.h"

void pll_reset(pll_t *pll, uint32_t angle, int32_t step)
{
    pll->angle = angle;
    pll->integral = step;
    pll->step = step;
    pll->kp = 0;
    pll->backwards = step < 0;
}

void pll_adapt(pll_t *pll, const pll_config_t *config, frac16_t emf)
{
    const frac16_t root = f16_sqrt(f32_from_f16((emf > config->e_least) ? emf : config->e_least));
    const int32_t over = (INT32_C(1) << 30) / ((root > 0) ? root : 1); /* 15 fraction bits */
    pll->kp = sat32(asr64((int64_t)config->kp * over, 15));
}

void pll_push(pll_t *pll, const pll_config_t *config, frac16_t i_q)
{
    const int32_t gained = (int32_t)asr64((int64_t)i_q * config->acceleration, 15);
    pll->integral = f32_clip(f32_add(pll->integral, gained), config->step_most);
}

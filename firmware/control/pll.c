#include "control/pll.h"

#define TICK_BITS 3 /* a slow tick has eight periods */
#define BIAS_MAX (INT32_C(1) << 22) /* half of full scale: prevents overflow below */

void pll_reset(pll_t *pll, uint32_t angle, int32_t step)
{
    pll->angle = angle;
    pll->integral = step;
    pll->step = step;
    pll->kp = 0;
    pll->root = 0;
    pll->load = 0;
    pll->bias = 0;
    pll->backwards = step < 0;
}

void pll_adapt(pll_t *pll, const pll_config_t *config, frac16_t emf)
{
    pll->root = f16_sqrt(f32_from_f16((emf > config->e_min) ? emf : config->e_min));
    const int32_t over = (INT32_C(1) << 30) / ((pll->root > 0) ? pll->root : 1); /* 15 fraction bits */
    pll->kp = sat32(asr64((int64_t)config->kp * over, 15));
}

static int64_t driven_by(const pll_config_t *config, frac16_t i_q)
{
    return asr64((int64_t)i_q * config->acceleration, 15);
}

void pll_retune(pll_t *pll, const pll_config_t *before, const pll_config_t *config, frac16_t i_q)
{
    pll->load = sat32(pll->load + driven_by(before, i_q) - driven_by(config, i_q));
}

void pll_feed_forward(pll_t *pll, const pll_config_t *config, frac16_t i_q, dq_t residual_emf, int32_t rotation)
{
    const int32_t error =
        (pll->backwards ? residual_emf.d : -(int32_t)residual_emf.d) * (int32_t)pll->root; /* 30 fraction bits */
    const int32_t size = residual_emf.q * (INT32_C(1) << 8) - pll->bias;
    pll->bias =
        f32_clip(pll->bias + f32_gain(pll->integral - asr32(rotation, TICK_BITS), config->offset_gain), BIAS_MAX);
    pll->load = sat32(pll->load + asr64((int64_t)error * config->load_gain, 30) +
                      (int64_t)f32_gain(size, config->amplitude_load_gain));
    const int64_t gained = driven_by(config, i_q) + pll->load + (int64_t)f32_gain(size, config->amplitude_gain);
    pll->integral = f32_limit(pll->integral + gained, config->step_max);
}

#include "sensing/rotor_follow.h"

static bool turning_out(const rotor_follow_t *follow, const rotor_follow_config_t *config)
{
    return follow->tick < config->ticks;
}

void rotor_follow_start(rotor_follow_t *follow, frac16_t theta) { *follow = (rotor_follow_t){.theta = theta}; }

void rotor_follow_add(rotor_follow_t *follow, const rotor_follow_config_t *config, frac16_t u_across)
{
    const int32_t inductive = turning_out(follow, config) ? config->inductive : -(int32_t)config->inductive;
    follow->flux = sat32((int64_t)follow->flux + u_across - inductive);
    follow->low = (follow->flux < follow->low) ? follow->flux : follow->low;
    follow->high = (follow->flux > follow->high) ? follow->flux : follow->high;
}

bool rotor_follow_step(rotor_follow_t *follow, const rotor_follow_config_t *config)
{
    const frac16_t step = (frac16_t)config->step;
    follow->theta = turning_out(follow, config) ? f16_add_wrap(follow->theta, step) : f16_sub_wrap(follow->theta, step);
    follow->tick++;
    return follow->tick >= 2U * (uint32_t)config->ticks;
}

bool rotor_follow_seen(const rotor_follow_t *follow, const rotor_follow_config_t *config)
{
    return (int64_t)follow->high - follow->low >= config->flux_min;
}

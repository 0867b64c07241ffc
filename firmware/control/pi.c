#include "control/pi.h"

void pi_reset(pi_state_t *state, frac32_t integral)
{
    state->integral = integral;
    state->excess = 0;
}

frac32_t pi_step(pi_state_t *state, const pi_gains_t *gains, frac32_t error, frac32_t feed_forward, frac32_t limit)
{
    const frac32_t u_p = f32_gain(error, gains->kp);
    const frac32_t u_c = f32_gain(state->excess, gains->kc);
    state->integral = sat32((int64_t)state->integral + f32_gain(error, gains->ki) + u_c);

    const int64_t u_presat = (int64_t)u_p + state->integral + feed_forward;
    const frac32_t u_out = f32_limit(u_presat, limit);
    state->excess = sat32(u_out - u_presat);
    return u_out;
}

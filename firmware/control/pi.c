#include "control/pi.h"

void pi_reset(pi_state_t *state, frac32_t integral)
{
    state->integral = pi_sum_of(integral);
    state->excess = 0;
}

#include "control/field_weakening.h"

#include "math/trig.h"

#define SLEW_SHIFT 3

/* Voltage reserve u_target^2 - |u|^2. */
static frac32_t squared_voltage_reserve(frac16_t target, dq_t demand)
{
    const int64_t square = (int64_t)f32_mul16(demand.d, demand.d) + f32_mul16(demand.q, demand.q);
    return sat32(f32_mul16(target, target) - square);
}

/* Below half of the target voltage the back-EMF is not the cause of a high voltage. */
static bool emf_is_high(frac16_t emf, frac16_t target) { return 2 * i32_abs(emf) > target; }

/* Change of the field-weakening current -i_d in this tick: K (|u|^2 - u_target^2), within the slew rate. Field
 * weakening begins when this becomes positive. */
static frac32_t i_d_change(const field_weakening_config_t *config, const field_weakening_input_t *input)
{
    const frac32_t slew = asr32(f32_from_f16(config->i_d_max), SLEW_SHIFT);
    const frac16_t target = (input->u_max > config->margin) ? f16_sub(input->u_max, config->margin) : 0;
    const bool unneeded = !input->enabled && i32_abs(input->emf) <= input->u_max;
    if (unneeded || !emf_is_high(input->emf, target)) {
        return -slew;
    }
    const int64_t requested = -(int64_t)squared_voltage_reserve(target, input->demand) * config->gain;
    const frac32_t change = f32_limit(asr64(requested, FIELD_WEAKENING_GAIN_BITS), slew);
    return (input->enabled || change < 0) ? change : 0;
}

/* Largest -i_d: the configured value, at most 7/8 of the present current limit; sqrt(1 - (7/8)^2) = 48 % of that limit
 * remain for i_q. */
static frac16_t i_d_bound(const field_weakening_config_t *config, frac16_t current)
{
    const frac16_t part = (frac16_t)(current - asr32(current, 3));
    return (config->i_d_max < part) ? config->i_d_max : part;
}

static frac32_t within(frac32_t x, frac32_t max)
{
    if (x < 0) {
        return 0;
    }
    return (x > max) ? max : x;
}

/* Largest i_q on a current circle of radius `current`, given `d`. */
static frac16_t circle(frac16_t current, frac16_t d) { return f16_sqrt(f32_mul16(current, current) - f32_mul16(d, d)); }

void field_weakening_step(field_weakening_t *state, const field_weakening_config_t *config,
                          const field_weakening_input_t *input)
{
    const frac32_t end = f32_from_f16(i_d_bound(config, input->current));
    const frac32_t change = i_d_change(config, input);
    const bool q_moves = (change > 0) ? state->d >= end : state->q > 0;
    state->d = within(q_moves ? state->d : f32_add(state->d, change), end);
    state->i_q_max = circle(input->current, field_weakening_i_d(state));
    if (q_moves) {
        const frac32_t share = sat32(asr64((int64_t)change * config->q_share, 15));
        state->q = f32_add(state->q, share);
    }
    state->q = within(state->q, f32_from_f16(state->i_q_max));
}

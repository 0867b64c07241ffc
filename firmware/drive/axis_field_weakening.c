#include "drive/axis_field_weakening.h"

/* Voltage that a controller demands, before limitation. */
static frac16_t demand_of(frac16_t voltage, const pi_state_t *controller)
{
    return f16_sub(voltage, f16_from_f32(controller->excess));
}

/* Back-EMF of the magnets, as used by the decoupling. */
static frac16_t emf_of(const axis_t *axis)
{
    return (frac16_t)current_loop_rounded(
        pi_sum_add(0, axis->current_loop.omega_e, axis->config->current_loop.omega_psi));
}

void axis_field_weakening_step(axis_t *axis)
{
    const axis_config_t *config = axis->config;
    const current_loop_t *loop = &axis->current_loop;
    const bool spins = axis->sm.state == STATE_RUN && axis->substate == SUBSTATE_SPIN;
    const bool enabled = spins && (axis->parameter.features & FEATURE_FIELD_WEAKENING) != 0U;
    if (!enabled && (!spins || axis->weakening.d == 0)) {
        axis->weakening = (field_weakening_t){0};
        return;
    }
    const bool compensates = (axis->parameter.features & FEATURE_BUS_COMPENSATION) != 0U || axis->estimate.runs;
    const field_weakening_input_t input = {
        .demand = {demand_of(loop->voltage.d, &loop->d), demand_of(loop->voltage.q, &loop->q)},
        .u_max = f16_mul(compensates ? axis->u_dc : config->u_dc_nominal, config->current_loop.modulation_limit),
        .emf = emf_of(axis),
        .current = axis->current_max.vector,
        .enabled = enabled,
    };
    field_weakening_step(&axis->weakening, &config->field_weakening, &input);
}

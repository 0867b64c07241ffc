#include "app/analog_out.h"

#define MIDDLE UINT16_C(0x8000)
#define PER_AXIS (MONITOR_AXIS2_I_D - MONITOR_AXIS1_I_D) /* same order of quantities for both axes */

bool analog_out_selected(const board_parameters_t *settings)
{
    bool requested = false;
    for (uint16_t i = 0; i < HAL_ANALOG_OUTS; i++) {
        requested = requested || settings->monitor[i] != MONITOR_NONE;
    }
    return requested;
}

static int16_t quantity_of(const axis_t *axis, uint16_t which)
{
    switch (which) {
    case MONITOR_AXIS1_I_D:
        return axis->current_loop.current.d;
    case MONITOR_AXIS1_I_Q:
        return axis->current_loop.current.q;
    case MONITOR_AXIS1_I_Q_REF:
        return axis->current_ref.q;
    case MONITOR_AXIS1_U_D:
        return axis->current_loop.voltage.d;
    case MONITOR_AXIS1_U_Q:
        return axis->current_loop.voltage.q;
    case MONITOR_AXIS1_THETA_E:
        return axis->feedback.theta_e;
    default:
        return f16_from_f32(axis->feedback.speed);
    }
}

static int16_t value_of(const axis_t *axes, uint16_t which)
{
    if (which == MONITOR_U_DC) {
        return axes[0].u_dc;
    }
    if (which >= MONITOR_AXIS1_I_D && which < MONITOR_AXIS2_I_D) {
        return quantity_of(&axes[0], which);
    }
    if (which >= MONITOR_AXIS2_I_D && which < MONITOR_AXIS2_I_D + PER_AXIS) {
        return quantity_of(&axes[1], (uint16_t)(which - PER_AXIS));
    }
    return 0;
}

void analog_out_step(const board_parameters_t *settings, const axis_t *axes, hal_t *hal, int16_t *shown)
{
    for (uint16_t i = 0; i < HAL_ANALOG_OUTS; i++) {
        const int16_t value = value_of(axes, settings->monitor[i]);
        shown[i] = value;
        hal_analog_out(hal, i, (uint16_t)((uint16_t)value + MIDDLE));
    }
}

#include "drive/holding_brake.h"

/* Currents or shorted windings hold, or at least brake, the shaft. */
static bool held_by_drive(const axis_t *axis)
{
    return axis->sm.state == STATE_RUN && axis->substate != SUBSTATE_CALIB && axis->substate != SUBSTATE_FREEWHEEL;
}

static void follow(axis_t *axis, bool open)
{
    holding_brake_t *brake = &axis->brake;
    if (brake->powered != open) {
        brake->powered = open;
        brake->ticks = open ? axis->config->pins.open_ticks : axis->config->pins.close_ticks;
        hal_holding_brake(axis->hal, axis->index, open);
    } else if (brake->ticks > 0U) {
        brake->ticks--;
    }
}

void holding_brake_step(axis_t *axis)
{
    holding_brake_t *brake = &axis->brake;
    if (!holding_brake_fitted(axis) || !held_by_drive(axis)) {
        brake->open_requested = false;
    } else if (axis->substate == SUBSTATE_SPIN && axis->enable_requested) {
        brake->open_requested = true; /* also if the drive is requested again while a stop closes the brake */
    }
    follow(axis, brake->open_requested);
    const bool open = brake->powered && brake->ticks == 0U;
    if (open && axis->motion.resting) {
        brake->load = axis->current_ref.q;
    }
    axis->inputs = (uint16_t)((axis->inputs & (uint16_t)~INPUT_BRAKE_OPEN) | (open ? INPUT_BRAKE_OPEN : 0U));
}

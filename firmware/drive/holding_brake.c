#include "drive/holding_brake.h"

/* There are currents, or shorted windings, that hold or at least brake the shaft. */
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
    if (!holding_brake_fitted(axis)) {
        if (axis->brake.powered) {
            follow(axis, false);
        }
        return;
    }
    if (!held_by_drive(axis)) {
        axis->brake.wanted = false;
    } else if (axis->substate == SUBSTATE_SPIN && axis->requested) {
        axis->brake.wanted = true; /* also when the drive is wanted again while a stop closes the brake */
    }
    follow(axis, axis->brake.wanted);
    if (axis->motion.resting && holding_brake_open(axis)) {
        axis->brake.load = axis->current_ref.q;
    }
    if (holding_brake_open(axis)) {
        axis->inputs = (uint16_t)(axis->inputs | INPUT_BRAKE_OPEN);
    } else {
        axis->inputs = (uint16_t)(axis->inputs & (uint16_t)~INPUT_BRAKE_OPEN);
    }
}

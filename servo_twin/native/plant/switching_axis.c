#include "plant/switching_axis.h"

#include <math.h>

#include "plant/trig.h"

uint64_t switching_trip_clock(const switching_t *plant, const switching_axis_t *axis)
{
    const switched_inverter_t *inv = &axis->inverter;
    const double side = 0.5 * PLANT_SQRT3 * inv->di.beta;
    const double slope[3] = {inv->di.alpha, -0.5 * inv->di.alpha + side, -0.5 * inv->di.alpha - side};
    double soonest = SWITCHING_HORIZON * CLOCK;
    for (int k = 0; k < 3; k++) {
        const double size = fabs(inv->phase[k]);
        const double grows = (inv->phase[k] > 0.0) ? slope[k] : -slope[k];
        const double t = (axis->i_break - size) / grows;
        if (t >= 0.0 && t < soonest) {
            soonest = t;
        }
    }
    return (soonest < SWITCHING_HORIZON * CLOCK) ? clock_after(axis->clock, soonest, plant->now) : NEVER;
}

void switching_compare(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    const double *phase = axis->inverter.phase;
    const double i_max = axis->i_break;
    const bool tripped = phase[0] > i_max || phase[1] > i_max || phase[2] > i_max || phase[0] < -i_max ||
                         phase[1] < -i_max || phase[2] < -i_max || axis->short_clock > plant->now;
    if (tripped != axis->tripped) {
        axis->tripped = tripped;
        queue_event(plant, (switching_event_t){plant->now, SWITCHING_OVER_CURRENT, (uint8_t)i, 0, tripped});
    }
}

void switching_find_next_event(switching_t *plant)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        if (!plant->axis[i].inverter.segment_valid) {
            switched_inverter_begin(&plant->axis[i].inverter, plant->supply.u);
            after_new_segment(plant, i, square_of(&plant->axis[i]));
        }
    }
    update_next(plant);
    plant->stale = false;
}

void switching_advance_supply(switching_t *plant) { move_supply(plant); }

void switching_advance_axis(switching_t *plant, int i)
{
    if (plant->axis[i].clock != plant->now) {
        double square;
        (void)move_axis(plant, i, &square);
        plant->stale = true;
    }
}

switched_inverter_t *switching_prepare_change(switching_t *plant, int i)
{
    switching_find_next_event(plant);
    switched_inverter_t *inverter = &plant->axis[i].inverter;
    switching_pass_deferred(plant, i);
    switching_advance_axis(plant, i);
    switched_inverter_sync(inverter);
    inverter->segment_valid = false;
    inverter->trajectory_changed = true;
    plant->stale = true;
    return inverter;
}

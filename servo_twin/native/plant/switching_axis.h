/* switching_axis.h - advance one axis and the bus of the switching plant; over-current comparator.
 * Internal: only the files switching* include it.
 */
#ifndef PLANT_SWITCHING_AXIS_H
#define PLANT_SWITCHING_AXIS_H

#include "plant/inline.h"
#include "plant/switching_encoder.h"

/* Square of the current vector [A^2]. */
static inline double square_of(const switching_axis_t *axis)
{
    const plant_vector_t current = axis->inverter.i;
    return current.alpha * current.alpha + current.beta * current.beta;
}

/* Update the output of the comparator. */
void switching_compare(switching_t *plant, int axis);

/* Earliest clock at which a current reaches the comparator's threshold, by linear extrapolation. */
uint64_t switching_trip_clock(const switching_t *plant, const switching_axis_t *axis);

/* Advance the bus to the present clock, with the currents of both axes extrapolated linearly. */
PLANT_INLINE void move_supply(switching_t *plant)
{
    const uint64_t from = plant->supply_clock;
    if (plant->now == from) {
        return;
    }
    const double h = seconds(from, plant->now);
    const double load = (plant->i_bus[0] + plant->i_bus[1]) + h * (0.5 * (plant->di_bus[0] + plant->di_bus[1]));
    for (int i = 0; i < BOARD_AXES; i++) {
        const double rise = h * plant->di_bus[i];
        plant->charge_booked[i] += h * (plant->i_bus[i] + 0.5 * rise);
        plant->i_bus[i] += rise;
    }
    const supply_step_t step = supply_step_of(&plant->supply, h);
    const double u_h = supply_take_step(&plant->supply, &step, load);
    for (int i = 0; i < BOARD_AXES; i++) {
        plant->u_h[i] += u_h;
    }
    plant->supply_clock = plant->now;
}

/* Advance an axis to the present clock; *square becomes that of its current. Returns the bus voltage before the correction by
 * the axis' actual charge: available earlier, and equal for the slopes of a segment. */
PLANT_INLINE double move_axis(switching_t *plant, int i, double *square)
{
    switching_axis_t *axis = &plant->axis[i];
    const double h = seconds(axis->clock, plant->now);
    const double per_h = 1.0 / h; /* computed in parallel with the voltage */
    move_supply(plant);
    const double u = plant->supply.u;
    const double charge = switched_inverter_advance(&axis->inverter, h, plant->u_h[i] * per_h);
    supply_take(&plant->supply, charge - plant->charge_booked[i]);
    plant->charge_booked[i] = 0.0;
    plant->u_h[i] = 0.0;
    axis->clock = plant->now;
    axis->shown_clock = NEVER;
    *square = square_of(axis);
    if (axis->tripped || *square > axis->square_break) {
        switching_compare(plant, i);
    }
    return u;
}

/* Update what follows from a new segment of an axis: bus current, encoder edge, next event. `square` is that of its current. */
static inline void after_new_segment(switching_t *plant, int i, double square)
{
    switching_axis_t *axis = &plant->axis[i];
    plant->i_bus[i] = switched_inverter_bus_current(&axis->inverter);
    plant->di_bus[i] = switched_inverter_bus_current_slope(&axis->inverter);
    if (axis->inverter.trajectory_changed) {
        axis->inverter.trajectory_changed = false;
        switching_update_trajectory(plant, i);
    }
    axis->trip_clock = (square < axis->square_far) ? NEVER : switching_trip_clock(plant, axis);
    update_axis_clock(axis);
}

/* move_supply and move_axis where speed does not matter. */
void switching_advance_supply(switching_t *plant);
void switching_advance_axis(switching_t *plant, int axis);

/* Advance an axis to the present clock for a change of the returned inverter. */
switched_inverter_t *switching_prepare_change(switching_t *plant, int axis);

#endif

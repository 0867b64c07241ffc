#include "plant/switching_gates.h"

#include "plant/switching_axis.h"

/* ---- shorts ----------------------------------------------------------------------------------------------------------- */

/* Trip the comparator until a clock. How a leg with both switches on carries the motor's current is not modelled. */
static void short_until(switching_t *plant, int i, uint64_t until)
{
    plant->axis[i].short_clock = until;
    plant->stale = true;
    switching_update_other_clock(plant);
    switching_compare(plant, i);
}

/* True if both rails feed a short in the cable: an upper switch with bus minus, or with the lower switch of the other phase. */
static bool feeds_short(const switching_axis_t *axis)
{
    const switched_inverter_t *inv = &axis->inverter;
    if (inv->grounded >= 0) {
        return axis->leg[inv->grounded] == SWITCHING_HIGH;
    }
    if (inv->unshorted >= 0) {
        const switching_leg_t next = axis->leg[(inv->unshorted + 1) % 3];
        const switching_leg_t other = axis->leg[(inv->unshorted + 2) % 3];
        return (next == SWITCHING_HIGH && other == SWITCHING_LOW) || (next == SWITCHING_LOW && other == SWITCHING_HIGH);
    }
    return false;
}

void switching_check_cable(switching_t *plant, int i)
{
    switching_axis_t *axis = &plant->axis[i];
    const bool fed = feeds_short(axis);
    if (fed != axis->short_fed) {
        axis->short_fed = fed;
        short_until(plant, i, fed ? NEVER : plant->now);
    }
}

/* Both switches of a leg are on, have been on, or one has closed within the other one's dead time. */
static void check_overlap(switching_t *plant, int i, int phase, switching_leg_t before, switching_leg_t leg)
{
    const switching_axis_t *axis = &plant->axis[i];
    if (before == SWITCHING_SHORT) {
        short_until(plant, i, plant->now);
    }
    if (leg == SWITCHING_SHORT) {
        short_until(plant, i, NEVER);
    } else if (leg != SWITCHING_OPEN && leg != axis->last_on[phase] && plant->now < axis->safe_clock[phase]) {
        short_until(plant, i, axis->safe_clock[phase]);
    }
}

static inline void check_leg(switching_t *plant, int i, int phase, switching_leg_t leg)
{
    switching_axis_t *axis = &plant->axis[i];
    const switching_leg_t before = axis->leg[phase];
    axis->leg[phase] = leg;
    if (before == SWITCHING_HIGH || before == SWITCHING_LOW) {
        axis->safe_clock[phase] = plant->now + axis->dead_time_min;
        axis->last_on[phase] = before;
    }
    const bool in_dead_time = leg != SWITCHING_OPEN && plant->now < axis->safe_clock[phase];
    if (in_dead_time || before == SWITCHING_SHORT || leg == SWITCHING_SHORT) {
        check_overlap(plant, i, phase, before, leg);
    }
    if (axis->inverter.shorted) {
        switching_check_cable(plant, i);
    }
}

/* ---- edges ------------------------------------------------------------------------------------------------------------ */

/* Begin a segment with new gates. */
static inline void set_gates(switching_t *plant, int i, unsigned gates)
{
    switching_axis_t *axis = &plant->axis[i];
    switched_inverter_t *inv = &axis->inverter;
    double u = plant->supply.u;
    double square;
    if (axis->clock != plant->now) {
        u = move_axis(plant, i, &square);
    } else {
        switched_inverter_restart(inv); /* several legs switch at one clock */
        square = square_of(axis);
    }
    inv->gates = gates;
    switched_inverter_begin(inv, u);
    after_new_segment(plant, i, square);
    update_next(plant);
}

void switching_edge(switching_t *plant, int i, int phase, switching_leg_t leg)
{
    switching_axis_t *axis = &plant->axis[i];
    switched_inverter_t *inv = &axis->inverter;
    if (axis->leg[phase] == leg) {
        return;
    }
    const unsigned gates = switched_inverter_gates_with(inv, phase, leg);
    if (switched_inverter_edge_has_no_effect(inv, phase, gates, seconds(axis->clock, plant->now), plant->supply.u)) {
        inv->gates = gates;
    } else {
        set_gates(plant, i, gates);
    }
    check_leg(plant, i, phase, leg);
}

/* Fault injection in the switching plant. */
#include "plant/switching_axis.h"
#include "plant/switching_gates.h"

static void set_sensor_fault(switching_t *plant, const board_fault_t *fault, bool cleared)
{
    switching_axis_t *axis = &plant->axis[fault->axis];
    switch ((board_fault_kind_t)fault->kind) {
    case BOARD_STUCK_CONVERTER:
        axis->faults.stuck[fault->part] = !cleared;
        axis->faults.code[fault->part] = plant_code(fault->value);
        break;
    case BOARD_CURRENT_NOISE:
        axis->i_noise = cleared ? axis->faults.i_noise_configured : fault->value;
        break;
    case BOARD_BUS_NOISE:
        plant->u_noise = cleared ? plant->u_noise_configured : fault->value;
        break;
    case BOARD_STALLED_CORE:
        break; /* not part of the plant */
    case BOARD_HEAT:
        axis->faults.sink_held = !cleared;
        axis->sink.t = cleared ? axis->sink.t : fault->value;
        break;
    default:
        break;
    }
}

static void set_phase_fault(switching_t *plant, const board_fault_t *fault, bool cleared)
{
    switched_inverter_t *inverter = switching_prepare_change(plant, fault->axis);
    const int to = (int)fault->value;
    if (fault->kind == BOARD_OPEN_PHASE) {
        switched_inverter_open(inverter, fault->part, !cleared);
    } else if (to < 0) {
        switched_inverter_short(inverter, cleared ? -1 : fault->part, -1);
    } else {
        switched_inverter_short(inverter, -1, cleared ? -1 : 3 - fault->part - to);
    }
    switching_check_cable(plant, fault->axis);
}

static void set_line_fault(switching_t *plant, const board_fault_t *fault, bool cleared)
{
    switching_axis_t *axis = &plant->axis[fault->axis];
    axis->faults.glitches[fault->part] = cleared ? 0.0 : fault->value;
    if (!axis->encoder.flipped[fault->part]) { /* a disturbance in progress ends first */
        switching_schedule_glitch(plant, fault->axis, fault->part);
    }
    plant->stale = true;
    switching_update_other_clock(plant);
}

static void slip_disc(switching_t *plant, const board_fault_t *fault)
{
    switching_start_slip(plant, fault->axis, (int32_t)fault->value);
    plant->stale = true;
    switching_update_other_clock(plant);
}

static void set_supply_fault(switching_t *plant, const board_fault_t *fault, bool cleared)
{
    switching_find_next_event(plant);
    switching_advance_supply(plant);
    if (cleared) {
        supply_recover(&plant->supply);
    } else {
        supply_dip(&plant->supply, fault->value, fault->seconds);
    }
}

void switching_set_fault(switching_t *plant, const board_fault_t *fault, bool cleared)
{
    switch ((board_fault_kind_t)fault->kind) {
    case BOARD_OPEN_PHASE:
    case BOARD_SHORTED_PHASE:
        set_phase_fault(plant, fault, cleared);
        break;
    case BOARD_ENCODER_GLITCHES:
        set_line_fault(plant, fault, cleared);
        break;
    case BOARD_SLIPPED_ENCODER:
        if (!cleared) {
            slip_disc(plant, fault);
        }
        break;
    case BOARD_STUCK_LINE:
        switching_cut(plant, fault->axis, fault->part, !cleared, fault->value != 0.0);
        break;
    case BOARD_LOCKED_ROTOR:
        switching_lock(plant, fault->axis, !cleared);
        break;
    case BOARD_SUPPLY_DIP:
        set_supply_fault(plant, fault, cleared);
        break;
    default:
        set_sensor_fault(plant, fault, cleared);
        break;
    }
}

#include "drive/faults.h"

#include "drive/axis.h"

uint16_t fault_code(fault_set_t faults)
{
    uint16_t code = 0;
    if (faults != 0U) {
        code = 1;
        while ((faults & 1U) == 0U) {
            faults >>= 1;
            code++;
        }
    }
    return code;
}

void fault_record_sample(fault_record_t *record, const axis_t *axis)
{
    const uint16_t k = record->next;
    record->i_d[k] = axis->current_loop.current.d;
    record->i_q[k] = axis->current_loop.current.q;
    record->theta_e[k] = axis->feedback.theta_e;
    record->u_dc[k] = (frac16_t)asr32(axis->u_dc_now, 16);
    record->speed[k] = f16_from_f32(axis->feedback.speed);
    record->next = (uint16_t)((k + 1U) % FAULT_SAMPLES);
    if (record->size < FAULT_SAMPLES) {
        record->size++;
    }
}

void fault_record_first(fault_record_t *record, const axis_t *axis, fault_set_t faults)
{
    fault_record_sample(record, axis);
    record->code = fault_code(faults);
    record->tick = *axis->clock;
    record->state = (uint16_t)axis->sm.state;
    record->substate = (uint16_t)axis->substate;
}

#include "drive/axis_faults.h"

#include "diagnosis/fault_isolate.h"
#include "drive/stop.h"

void axis_raise(axis_t *axis, finding_set_t findings)
{
    fault_latch_t *latch = &axis->latch;
    const finding_set_t known = (axis->sm.state == STATE_FAULT) ? latch->findings : 0U;
    if (!fault_relevant(findings & ~known, latch->enabled)) {
        return;
    }
    evidence_t evidence = {.confirmed = findings};
    axis_observe(axis);
    axis->observation.state = (uint16_t)axis->sm.state;
    axis->observation.substate = (uint16_t)axis->substate;
    diagnosis_suspect(&axis->diagnosis, &axis->config->winding, &axis->observation, &evidence);
    const fault_set_t faults = fault_latch_capture(latch, &evidence, &axis->observation);
    if (faults != 0U) {
        const stop_category_t category = stop_for(&axis->config->stop, faults);
        if (category == STOP_CATEGORY_COAST || !stop_is_controllable(axis)) {
            axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_FAULT);
        } else {
            axis->stop_faults |= faults;
            stop_begin(axis, category);
        }
    }
}

void axis_stop_with(axis_t *axis, finding_set_t findings)
{
    if (axis->enable_requested) {
        axis_raise(axis, findings);
    }
}

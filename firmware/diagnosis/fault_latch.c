#include "diagnosis/fault_latch.h"

#include "config/contract_gen.h"
#include "diagnosis/fault_isolate.h"

uint16_t fault_code(fault_set_t faults) { return (faults != 0U) ? (uint16_t)(fault_lowest(faults) + 1U) : 0U; }

void fault_latch_init(fault_latch_t *latch, fault_record_t *record, const uint32_t *clock)
{
    *record = (fault_record_t){0};
    *latch = (fault_latch_t){.enabled = (fault_set_t)PARAM_FAULTS_ENABLED_MAX, .record = record, .clock = clock};
}

static void sample(fault_record_t *record, const observation_t *observation)
{
    const uint16_t k = record->next;
    record->i_d[k] = observation->current.d;
    record->i_q[k] = observation->current.q;
    record->theta_e[k] = observation->theta_e;
    record->u_dc[k] = observation->u_dc;
    record->speed[k] = f16_from_f32(observation->speed);
    record->next = (uint16_t)((k + 1U) % FAULT_SAMPLES);
    if (record->size < FAULT_SAMPLES) {
        record->size++;
    }
}

void fault_latch_sample(fault_latch_t *latch, const observation_t *observation)
{
    if (latch->captured == 0U) {
        sample(latch->record, observation);
    }
}

static void record_first(const fault_latch_t *latch, const observation_t *observation, fault_set_t first)
{
    fault_record_t *record = latch->record;
    sample(record, observation);
    record->code = fault_code(first);
    record->tick = *latch->clock;
    record->state = observation->state;
    record->substate = observation->substate;
}

fault_set_t fault_latch_capture(fault_latch_t *latch, const evidence_t *evidence, const observation_t *observation)
{
    const fault_verdict_t verdict = fault_isolate(evidence, latch->enabled);
    const fault_set_t fresh = verdict.faults & ~latch->captured;
    if (verdict.faults != 0U) {
        latch->findings |= evidence->confirmed;
    }
    if (fresh == 0U) {
        return verdict.faults;
    }
    if (latch->captured == 0U) {
        record_first(latch, observation, verdict.first);
        latch->first = latch->record->code;
    } else {
        const fault_revision_t revision = fault_revise(fresh, latch->captured, *latch->clock - latch->record->tick);
        if (revision.first != 0U) {
            latch->first = latch->record->code = fault_code(revision.first);
        }
        latch->captured &= ~revision.voids;
    }
    latch->captured |= fresh;
    return verdict.faults;
}

void fault_latch_clear(fault_latch_t *latch, fault_set_t remain)
{
    latch->captured = remain;
    latch->first = fault_code(remain);
    latch->findings = 0;
}

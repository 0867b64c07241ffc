#include "drive/monitors.h"

#include "diagnosis/fault_isolate.h"
#include "drive/axis_faults.h"
#include "drive/test_mode.h"

finding_set_t monitor_bus_now(const axis_t *axis)
{
    const bool settled = axis->sm.state != STATE_INIT;
    return bus_monitor_findings(&axis->diagnosis.bus, axis->u_dc, settled,
                                hal_over_current_active(axis->hal, axis->index));
}

/* ---- observation ---------------------------------------------------------------------------------------------------- */

/* Angle of the vector in the last period of STARTUP. */
static frac16_t startup_angle(const axis_t *axis)
{
    const startup_t *startup = &axis->startup;
    if (startup->phase == STARTUP_PROVE) {
        return axis->feedback.theta_e;
    }
    return (startup->phase == STARTUP_RAMP) ? pll_upper(startup->angle - (uint32_t)startup->step) : 0;
}

/* State of the current control, and angle of its d axis. */
static void observe_d_axis(axis_t *axis)
{
    observation_t *o = &axis->observation;
    const substate_t substate = (axis->sm.state == STATE_RUN) ? axis->substate : SUBSTATE_CALIB;
    o->switching = substate != SUBSTATE_CALIB && substate != SUBSTATE_FREEWHEEL;
    o->spins = substate == SUBSTATE_SPIN;
    o->controlled = true;
    if (o->spins) {
        o->d_axis_angle = axis->feedback.theta_e;
    } else if (substate == SUBSTATE_STARTUP) {
        o->d_axis_angle = startup_angle(axis);
    } else if (substate == SUBSTATE_TEST) {
        o->d_axis_angle = test_mode_angle(axis);
    } else if (substate == SUBSTATE_ALIGN && axis->diagnosis.stall.running) {
        o->d_axis_angle = axis->diagnosis.stall.vector_angle;
    } else {
        o->d_axis_angle = rotor_search_angle(&axis->search);
        o->controlled = substate == SUBSTATE_ALIGN && rotor_search_drives(&axis->search);
    }
}

/* `before` is the current of the previous slow tick. */
static void observe_currents(axis_t *axis, dq_t before)
{
    observation_t *o = &axis->observation;
    const current_loop_t *loop = &axis->current_loop;
    o->features = axis->parameter.features;
    o->count = axis->feedback.count;
    o->current_ref = axis->current_ref;
    o->voltage = loop->voltage;
    if (axis->diagnosis.encoder.stopped_abruptly) { /* not needed without a probe */
        o->integrator_d = loop->d.integral;
        o->integrator_q = loop->q.integral;
    }
    o->current_limit = axis->current_max.q;
    o->omega_e = f16_from_f32(loop->omega_e);
    o->current_magnitude = length_about(o->current.d, o->current.q);
    o->drop = i32_gain(o->current_magnitude, axis->config->winding.resistance);
    o->current_change = length_about(f16_sub(o->current.d, before.d), f16_sub(o->current.q, before.q));
    o->ticks_without_movement = axis->diagnosis.encoder.ticks_without_movement;
    o->stop_unconfirmed = encoder_monitor_stop_unconfirmed(&axis->diagnosis.encoder);
}

/* Rotate the sensed pair: all three converters are sampled within three ticks, independently of the duty cycles. */
static void rotate_sense_pair(axis_t *axis)
{
    const phase_pair_t next =
        (axis->sense.pair == PHASE_PAIR_CA) ? PHASE_PAIR_AB : (phase_pair_t)(axis->sense.pair + 1);
    axis->sense.pair = hal_pair(next);
    hal_adc_select(axis->hal, axis->index, axis->sense.pair);
}

/* ---- the monitors --------------------------------------------------------------------------------------------------- */

/* The sensed pair is AB, BC or CA. */
static void monitor_converters(axis_t *axis, evidence_t *evidence)
{
    const adc_pair_t codes = hal_adc_offsets(axis->hal, axis->index);
    const int32_t high[SENSE_PHASES] = {axis->sense.duty.a, axis->sense.duty.b, axis->sense.duty.c};
    const uint16_t first = (uint16_t)axis->sense.pair;
    const uint16_t second = (first == SENSE_PHASES - 1U) ? 0U : (uint16_t)(first + 1U);
    const uint32_t *offset = axis->sense.offset;
    const int32_t high_min = axis->config->offset_duty_min;
    const idle_sample_t samples[IDLE_SAMPLES] = {
        {first, codes.first, (uint16_t)(offset[first] >> SENSE_OFFSET_BITS), high[first] >= high_min},
        {second, codes.second, (uint16_t)(offset[second] >> SENSE_OFFSET_BITS), high[second] >= high_min},
    };
    current_sense_monitor_step(&axis->diagnosis.current_sense, samples, axis->observation.switching, evidence);
}

void monitor_currents(axis_t *axis)
{
    diagnosis_t *d = &axis->diagnosis;
    observation_t *o = &axis->observation;
    const dq_t before = o->current;
    d->evidence = (evidence_t){0};
    axis_observe(axis);
    observe_d_axis(axis);
    monitor_converters(axis, &d->evidence);
    if (axis->sm.state != STATE_RUN) {
        rotate_sense_pair(axis);
    }
    fault_latch_sample(&axis->latch, o);
    o->temperature = hal_adc_temperature(axis->hal, axis->index);
    heat_sink_monitor_step(&d->heat_sink, &axis->config->heat, o, &d->evidence);
    d->evidence.confirmed |= winding_model_findings(&d->winding);
    const bool possible =
        bus_monitor_fault_possible(&d->bus, axis->u_dc) || hal_over_current_active(axis->hal, axis->index);
    const finding_set_t now = d->evidence.confirmed | (possible ? monitor_bus_now(axis) : 0U);
    axis->latch.pending = (now != 0U) ? fault_names(now) : 0U;
    if (axis->sm.state != STATE_FAULT) {
        observe_currents(axis, before);
        phase_monitor_step(&d->phase, &axis->config->winding, o, &d->evidence);
        d->angle.conducting_phases = (uint16_t)(d->angle.conducting_phases | o->conducting_phases);
    }
}

/* Uses the encoder observation of the previous tick. */
void monitor_encoder(axis_t *axis)
{
    const axis_config_t *config = axis->config;
    diagnosis_t *d = &axis->diagnosis;
    observation_t *o = &axis->observation;
    if (axis->sm.state != STATE_FAULT && !o->sensorless) {
        encoder_monitor_step(&d->encoder, &config->winding, config->current_loop.q.kp, o, &d->evidence);
        if (o->spins) {
            angle_monitor_step(&d->angle, &config->winding, &config->current_loop, o, &d->evidence);
        }
    }
    axis->test_current = d->evidence.test_current;
    if (d->evidence.confirmed != 0U) {
        axis_raise(axis, d->evidence.confirmed);
    }
}

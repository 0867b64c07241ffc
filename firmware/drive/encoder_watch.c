#include "drive/encoder_watch.h"

#include "drive/axis.h"

#define REST_COUNTS 2     /* a shaft at rest may dither so far */
#define CALM_TICKS ENCODER_CALM_TICKS
#define WINDOW 32         /* slow ticks */
#define TOGGLES_LEAST 12  /* changes of the count in it: 375 Hz, no shaft dithers so fast */
#define WINDOWS_MOST 2
#define TURNING_TICKS 8
#define SWEPT_MOST 16384U /* a quarter of a turn; an eighth is looked for */
#define ASK_TICKS 4       /* the current controllers take less */
#define STILL_TICKS 60    /* of voltage that stays where it is */
#define SHORT_TICKS 8
#define SUDDEN_COUNTS 8   /* per slow tick: slower shafts drive no current that trips anything */
#define SETTLED_TICKS 8   /* until it flows */
#define PROBE_TICKS 80    /* in all: before the speed of the M/T method without its enhancement falls to zero */
#define SWINGS_MOST 4

void encoder_watch_start(encoder_watch_t *watch, int32_t position)
{
    *watch = (encoder_watch_t){.anchor = position, .last = position};
}

/* A window of a count that goes one back and forth; a shaft that hunts takes several. */
static bool chatters(encoder_watch_t *w, int32_t moved)
{
    w->window++;
    w->toggles = (uint16_t)(w->toggles + ((moved != 0) ? 1U : 0U));
    w->hunts = w->hunts || (moved != 0 && moved != -w->toggled && w->toggled != 0);
    w->toggled = (moved != 0) ? moved : w->toggled;
    if (w->window < WINDOW) {
        return false;
    }
    w->windows = (w->toggles >= TOGGLES_LEAST && !w->hunts) ? (uint8_t)(w->windows + 1U) : 0U;
    w->hunts = false;
    w->window = 0;
    w->toggles = 0;
    return w->windows >= WINDOWS_MOST;
}

static uint16_t size_of(int32_t moved)
{
    const uint32_t size = (moved < 0) ? 0U - (uint32_t)moved : (uint32_t)moved;
    return (size > UINT16_MAX) ? UINT16_MAX : (uint16_t)size;
}

fault_set_t encoder_watch_count(axis_t *axis)
{
    encoder_watch_t *w = &axis->encoder_watch;
    const int32_t position = axis->feedback.position;
    const int32_t away = i32_sub_wrap(position, w->anchor);
    const int32_t moved = i32_sub_wrap(position, w->last);
    w->last = position;
    if (away > REST_COUNTS || away < -REST_COUNTS) {
        *w = (encoder_watch_t){.anchor = position, .last = position, .pace = size_of(moved), .earlier = w->pace};
        return 0;
    }
    w->sudden = w->sudden || w->pace >= SUDDEN_COUNTS || w->earlier >= SUDDEN_COUNTS;
    w->pace = 0;
    w->earlier = 0;
    if (w->calm < UINT16_MAX) {
        w->calm++;
    }
    return chatters(w, moved) ? FAULT_ENCODER_LOST : 0U;
}

static frac16_t drop(frac16_t current, gain_t resistance)
{
    return f16_from_f32(f32_gain(f32_from_f16(current), resistance));
}

/* Voltage that the current does not need, without half of its noise: that of a current sample, times the controllers' gain,
 * is as large as the back-EMF looked for. */
static void note_unexplained(axis_t *axis)
{
    const gain_t resistance = axis->config->phases.resistance;
    const dq_t u = axis->current_loop.voltage;
    const dq_t i = axis->current_loop.current;
    dq_t *rest = &axis->encoder_watch.rest;
    rest->d = sat16(asr32((int32_t)rest->d + u.d - drop(i.d, resistance), 1));
    rest->q = sat16(asr32((int32_t)rest->q + u.q - drop(i.q, resistance), 1));
}

static bool current_flows(const axis_t *axis)
{
    const dq_t i = axis->current_loop.current;
    return length_about(i.d, i.q) >= 2 * (int32_t)axis->config->phases.silent;
}

/* Half of the resistance's voltage. */
static int32_t half_drop(const axis_t *axis)
{
    const dq_t i = axis->current_loop.current;
    return asr32(i32_gain(length_about(i.d, i.q), axis->config->phases.resistance), 1);
}

/* What half of the resistance, dead time and switches may account for. Nobody compensates these at small currents. */
static int32_t tolerated(const axis_t *axis)
{
    const phase_watch_config_t *config = &axis->config->phases;
    const dq_t i = axis->current_loop.current;
    const bool exact = (axis->features & FEATURE_DEAD_TIME) != 0U && length_about(i.d, i.q) > config->silent;
    return (exact ? 1 : 2) * (int32_t)config->emf_floor + half_drop(axis);
}

/* What the controllers add up for a current that does not flow turns, too, but more slowly than a rotor with a back-EMF of
 * that size. `beyond`: more than other reasons may account for. */
static void note_voltage(axis_t *axis, int32_t beyond)
{
    encoder_watch_t *w = &axis->encoder_watch;
    const dq_t voltage = w->rest;
    const bool rigid = !w->turned && w->swept > SWEPT_MOST;
    if (w->turning == 0U || rigid) {
        w->emf = voltage;
        w->swept = 0;
        w->turned = false;
        w->idle = 0;
        w->rigid = rigid || (w->turning > 0U && w->rigid);
    }
    w->swept += (uint32_t)asr64((int64_t)beyond * axis->config->phases.turn_per_voltage, 15);
    const int32_t along = asr32((int32_t)voltage.d * w->emf.d, 1) + asr32((int32_t)voltage.q * w->emf.q, 1);
    const int32_t across = asr32((int32_t)voltage.d * w->emf.q, 1) - asr32((int32_t)voltage.q * w->emf.d, 1);
    w->turned = w->turned || along < across || along < -across; /* more than an eighth of a turn */
    w->idle = (uint16_t)(w->idle + (current_flows(axis) ? 0U : 1U));
    w->turning++;
}

static frac16_t asked(const axis_t *axis)
{
    const int32_t wanted = 4 * (int32_t)axis->config->phases.silent;
    return (wanted < axis->limits.i_q) ? (frac16_t)wanted : axis->limits.i_q;
}

dq_t encoder_watch_asks(const axis_t *axis)
{
    const frac16_t current = asked(axis);
    return axis->encoder_watch.along_q ? (dq_t){0, current} : (dq_t){current, 0};
}

static frac16_t current_along(const axis_t *axis)
{
    return axis->encoder_watch.along_q ? axis->current_loop.current.q : axis->current_loop.current.d;
}

/* A back-EMF is still there when a current has been asked for; what noise has added up in the controllers is not. Not all
 * of it need be: the drops are different now, and the resistance may be wrong by as much. Where they happen to hide it, the
 * rotor turns on, and the next look is at another angle. */
static bool remains(const encoder_watch_t *w)
{
    return 4 * length_about(w->rest.d, w->rest.q) >= length_about(w->emf.d, w->emf.q);
}

/* The voltage turns like a back-EMF. Where hardly any current flows, or flowed while it did, or the voltage has stood before
 * for longer than a back-EMF does, it may be what the controllers add up in vain: then a current is asked for, where most
 * of the voltage is, for as long as they take. */
static fault_set_t lost(axis_t *axis)
{
    encoder_watch_t *w = &axis->encoder_watch;
    if (w->asking == 0U) {
        if (!w->rigid && 2 * (int32_t)w->idle <= (int32_t)w->turning && current_flows(axis)) {
            return phase_watch_rather(axis, FAULT_ENCODER_LOST);
        }
        w->along_q = f16_abs(w->rest.q) > f16_abs(w->rest.d);
        w->before = current_along(axis);
    }
    w->asking++;
    if (w->asking <= ASK_TICKS) {
        return 0;
    }
    w->asking = 0;
    const int32_t more = 4 * ((int32_t)current_along(axis) - w->before);
    if (more < 2 * (int32_t)asked(axis)) { /* where a phase lets nothing flow, a half of it at most comes */
        return phase_watch_rather(axis, FAULT_PHASE_LOST);
    }
    w->turning = 0;
    const bool certain = more >= 3 * (int32_t)asked(axis);
    const fault_set_t fault =
        certain ? phase_watch_or(axis, FAULT_ENCODER_LOST) : phase_watch_rather(axis, FAULT_ENCODER_LOST);
    return remains(w) ? fault : 0U;
}

/* A step of the set-point asks for voltage beyond that, through the current controllers' gain. */
static bool steps(axis_t *axis)
{
    encoder_watch_t *w = &axis->encoder_watch;
    const int32_t step = f16_abs(f16_sub(axis->current_ref.q, w->wanted));
    w->wanted = axis->current_ref.q;
    return i32_gain(step, axis->config->current_loop.q.kp) > (int32_t)axis->config->phases.emf_floor;
}

/* A shaft that has come to rest at once, without a current: has the encoder died? Within what dead time and switches take,
 * a back-EMF drives no voltage that the controllers would have to answer. */
static bool doubts(const axis_t *axis)
{
    const encoder_watch_t *w = &axis->encoder_watch;
    return w->sudden && w->asking == 0U && w->calm >= ENCODER_DOUBT_TICKS && !current_flows(axis) &&
           f16_abs(axis->current_ref.q) < 2 * (int32_t)axis->config->phases.silent;
}

/* A current that stays as it is needs a voltage that stays as it is, but for a rotor that turns. Somebody who asks for
 * another one will see whether the shaft moves. */
static fault_set_t probe(axis_t *axis)
{
    encoder_watch_t *w = &axis->encoder_watch;
    const dq_t held = {f16_from_f32(pi_integral(&axis->current_loop.d)),
                       f16_from_f32(pi_integral(&axis->current_loop.q))};
    w->probing++;
    if (w->probing <= SETTLED_TICKS) {
        w->along_q = false;
        w->emf = held;
        w->held = axis->current_ref.q;
        w->swings = 0;
        return 0;
    }
    const bool flows = 4 * (int32_t)current_along(axis) >= 3 * (int32_t)asked(axis);
    const int32_t swing = length_about((int32_t)held.d - w->emf.d, (int32_t)held.q - w->emf.q);
    w->swings = (flows && swing > (int32_t)axis->config->phases.emf_floor / 2) ? (uint8_t)(w->swings + 1U) : 0U;
    const bool turns = w->swings >= SWINGS_MOST;
    const bool changed = f16_abs(f16_sub(axis->current_ref.q, w->held)) > axis->config->phases.silent / 2;
    if (turns || changed || w->probing > PROBE_TICKS) {
        w->probing = 0;
        w->sudden = false;
        w->rest = (dq_t){0, 0};
    }
    return (turns && !changed) ? phase_watch_rather(axis, FAULT_ENCODER_LOST) : 0U;
}

/* One more tick of voltage. */
static void judge(axis_t *axis)
{
    encoder_watch_t *w = &axis->encoder_watch;
    note_unexplained(axis);
    const int32_t size = length_about(w->rest.d, w->rest.q);
    const int32_t beyond = size - tolerated(axis);
    if (beyond > 0) {
        note_voltage(axis, beyond);
    } else if (w->turning > 0U) {
        w->turning--;
        w->idle = (w->idle > w->turning) ? w->turning : w->idle;
    }
    const int32_t much = 4 * (int32_t)axis->config->phases.emf_floor + half_drop(axis);
    w->in_vain = (size > much) ? (uint16_t)(w->in_vain + 1U) : 0U;
}

/* The voltage turns with the rotor: it is a back-EMF. It grows and stays where it is: nothing lets a current flow. */
fault_set_t encoder_watch_voltage(axis_t *axis)
{
    encoder_watch_t *w = &axis->encoder_watch;
    const bool stepped = steps(axis);
    if (w->calm < CALM_TICKS) {
        w->turning = 0;
        w->in_vain = 0;
        return 0;
    }
    if (w->probing > 0U || doubts(axis)) {
        return probe(axis);
    }
    if (!stepped) {
        judge(axis);
    }
    if (w->asking > 0U || (w->turning >= TURNING_TICKS && w->turned)) {
        return lost(axis);
    }
    return (w->in_vain >= STILL_TICKS) ? phase_watch_or(axis, FAULT_PHASE_LOST) : 0U;
}

fault_set_t encoder_watch_suspects(const axis_t *axis)
{
    const bool shorted = axis->sm.state == STATE_RUN && axis->substate == SUBSTATE_READY;
    return (shorted && axis->encoder_watch.sudden) ? FAULT_ENCODER_LOST : 0U;
}

fault_set_t encoder_watch_short(axis_t *axis)
{
    encoder_watch_t *w = &axis->encoder_watch;
    const dq_t i = axis->current_loop.current;
    const bool flows = length_about(i.d, i.q) > 2 * (int32_t)axis->config->phases.silent;
    w->turning = (w->calm >= CALM_TICKS && flows) ? (uint16_t)(w->turning + 1U) : 0U;
    return (w->turning >= SHORT_TICKS) ? FAULT_ENCODER_LOST : 0U;
}

#include "drive/encoder_watch.h"

#include "drive/axis.h"

#define REST_COUNTS 2     /* a shaft at rest may dither so far */
#define CALM_TICKS ENCODER_CALM_TICKS
#define WINDOW 32         /* slow ticks */
#define TOGGLES_LEAST 12  /* changes of the count in it: 375 Hz, no shaft dithers so fast */
#define WINDOWS_MOST 2
#define TURNING_TICKS 8
#define STILL_TICKS 60    /* of voltage that stays where it is */
#define SHORT_TICKS 8
#define SUDDEN_COUNTS 8   /* per slow tick: slower shafts drive no current that trips anything */

void encoder_watch_start(encoder_watch_t *watch) { *watch = (encoder_watch_t){0}; }

/* A window of a count that does not leave its place. */
static bool chatters(encoder_watch_t *w, bool changed)
{
    w->window++;
    w->toggles = (uint16_t)(w->toggles + (changed ? 1U : 0U));
    if (w->window < WINDOW) {
        return false;
    }
    w->windows = (w->toggles >= TOGGLES_LEAST) ? (uint16_t)(w->windows + 1U) : 0U;
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
    const bool changed = moved != 0;
    w->last = position;
    if (away > REST_COUNTS || away < -REST_COUNTS) {
        *w = (encoder_watch_t){.anchor = position, .last = position, .pace = size_of(moved)};
        return 0;
    }
    w->sudden = w->sudden || w->pace >= SUDDEN_COUNTS;
    w->pace = 0;
    if (w->calm < UINT16_MAX) {
        w->calm++;
    }
    return chatters(w, changed) ? FAULT_ENCODER_LOST : 0U;
}

static frac16_t drop(frac16_t current, gain_t resistance)
{
    return f16_from_f32(f32_gain(f32_from_f16(current), resistance));
}

/* More voltage than the current needs while nothing is counted. */
static bool unexplained(axis_t *axis)
{
    encoder_watch_t *w = &axis->encoder_watch;
    const phase_watch_config_t *config = &axis->config->phases;
    const dq_t u = axis->current_loop.voltage;
    const dq_t i = axis->current_loop.current;
    const dq_t needed = {drop(i.d, config->resistance), drop(i.q, config->resistance)};
    const bool exact = (axis->features & FEATURE_DEAD_TIME) != 0U;
    const int32_t most = (exact ? 1 : 2) * (int32_t)config->emf_floor + length_about(needed.d, needed.q) / 2;
    const dq_t emf = {f16_sub(u.d, needed.d), f16_sub(u.q, needed.q)};
    if (length_about(emf.d, emf.q) <= most) {
        return false;
    }
    if (w->turning == 0U) {
        w->emf = emf;
        w->turned = false;
    }
    const int32_t along = asr32((int32_t)emf.d * w->emf.d + (int32_t)emf.q * w->emf.q, 1);
    const int32_t across = asr32((int32_t)emf.d * w->emf.q - (int32_t)emf.q * w->emf.d, 1);
    w->turned = w->turned || along < across || along < -across; /* more than an eighth of a turn */
    return true;
}

fault_set_t encoder_watch_voltage(axis_t *axis)
{
    encoder_watch_t *w = &axis->encoder_watch;
    if (w->calm < CALM_TICKS) {
        w->turning = 0;
    } else if (unexplained(axis)) {
        w->turning++;
    } else if (w->turning > 0U) {
        w->turning--;
    }
    if (w->turning >= TURNING_TICKS && w->turned) {
        return phase_watch_or(&axis->phases, FAULT_ENCODER_LOST); /* the voltage turns with the rotor */
    }
    return (w->turning >= STILL_TICKS) ? phase_watch_or(&axis->phases, FAULT_PHASE_LOST) : 0U;
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

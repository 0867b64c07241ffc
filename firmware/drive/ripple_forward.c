#include "drive/ripple_forward.h"

#include <string.h>

#define ANGLE_PER_COUNT UINT32_C(1073742) /* 2^32 / POSITION_PER_TURN */
#define PER_TURN ((int32_t)POSITION_PER_TURN)
#define FADED_IN UINT16_C(32768)
#define FADE_STEP UINT16_C(128) /* 256 slow ticks from 0 to FADED_IN */

/* Counts since the start of the present turn of the homed position. A turn is followed by a subtraction, also where the
 * position wraps at 32 bits; a division is needed only after the position has been set. */
static int32_t counts_in_turn(ripple_forward_t *ripple, int32_t position)
{
    int32_t counts = i32_sub_wrap(position, ripple->turn);
    if (counts < 0 || counts >= PER_TURN) {
        counts += (counts < 0) ? PER_TURN : -PER_TURN;
        if (counts < 0 || counts >= PER_TURN) {
            counts = position % PER_TURN;
            counts += (counts < 0) ? PER_TURN : 0;
        }
        ripple->turn = i32_sub_wrap(position, counts);
    }
    return counts;
}

/* Mechanical angle from the home position, 2^32 is one turn: that of the last slow tick, `counts` in its turn, and the
 * counts since then. */
static uint32_t angle_now(axis_t *axis, int32_t counts)
{
    const encoder_config_t *encoder = &axis->config->encoder;
    const int32_t part = (int32_t)asr64((int64_t)axis->feedback.part * (int32_t)ANGLE_PER_COUNT, 24);
    const uint16_t count = hal_encoder_count(axis->hal, axis->index);
    const int16_t moved = encoder_difference(encoder, count, axis->encoder.counter.count);
    return (uint32_t)counts * ANGLE_PER_COUNT + (uint32_t)part + (uint32_t)(int32_t)moved * encoder->angle_per_count;
}

/* True if the speed controller takes the current. Elsewhere nothing is in force: whatever starts the controller with a
 * current starts it without the feed-forward, which then fades in. */
static bool is_used(const axis_t *axis)
{
    const motion_t motion = axis->motion.motion;
    return axis->sm.state == STATE_RUN && axis->substate == SUBSTATE_SPIN && motion != MOTION_TORQUE &&
           motion != MOTION_PRESS;
}

void ripple_forward_restart(axis_t *axis)
{
    ripple_forward_t *ripple = &axis->ripple;
    pi_state_t *pi = &axis->motion.speed_pi;
    pi->integral = pi_sum_saturated(pi->integral + pi_sum_of(ripple->current));
    ripple->current = 0;
    ripple->fade = 0;
}

void ripple_forward_step(axis_t *axis)
{
    ripple_forward_t *ripple = &axis->ripple;
    const bool on = (axis->parameter.features & FEATURE_TORQUE_RIPPLE) != 0U;
    const bool known = axis->home.state == HOME_STATE_KNOWN; /* never without an encoder */
    /* Followed also while off: the position may wrap. */
    const int32_t counts = known ? counts_in_turn(ripple, axis->feedback.position) : 0;
    ripple->applied = 0;
    ripple->limit = (on && !known) ? LIMIT_ANGLE_UNKNOWN : 0U;
    if (!on && ripple->fade == 0U) {
        return; /* the usual case; the current is 0 */
    }
    if (!is_used(axis)) {
        ripple->current = 0;
        ripple->fade = 0;
        return;
    }
    if (!known) {
        ripple_forward_restart(axis);
        return;
    }
    if (!on) {
        ripple->fade = (uint16_t)(ripple->fade - FADE_STEP);
    } else if (ripple->fade < FADED_IN) {
        ripple->fade = (uint16_t)(ripple->fade + FADE_STEP);
    }
    const frac32_t full =
        torque_ripple_current(&axis->config->torque_ripple, angle_now(axis, counts), axis->feedback.speed);
    ripple->current = (frac32_t)asr64((int64_t)full * ripple->fade, 15);
}

void ripple_forward_retune(axis_t *axis, const axis_config_t *config)
{
    const torque_ripple_config_t *now = &axis->config->torque_ripple;
    if (axis->ripple.fade != 0U && memcmp(now, &config->torque_ripple, sizeof *now) != 0) {
        ripple_forward_restart(axis);
    }
}

#include "drive/stall_proof.h"

#include "drive/axis.h"
#include "drive/current_drive.h"

void stall_proof_start(axis_t *axis)
{
    const rotor_search_config_t *config = &axis->config->rotor_search;
    const int32_t current = f16_abs(axis->current_ref.q);
    axis->proof.runs = true;
    axis->proof.inductive = sat16((int32_t)config->follow.inductive * current / config->current_limit);
    axis->search = (rotor_search_t){.phase = ROTOR_SEARCH_TURN, .origin = axis->feedback.position};
    axis->search.vector = axis->feedback.theta_e;
    axis->current_ref.d = 0;
    rotor_follow_start(&axis->search.follow, axis->feedback.theta_e);
    current_loop_turn(&axis->current_loop, &axis->config->current_loop, 0);
}

/* The frame turns instead of the rotor, with the current along its q axis: across it lies the d axis. */
void stall_proof_fast(axis_t *axis)
{
    rotor_follow_config_t config = axis->config->rotor_search.follow;
    config.inductive = axis->proof.inductive;
    drive_current(axis, axis->search.vector);
    const frac16_t u_d = axis->current_loop.voltage.d;
    rotor_follow_add(&axis->search.follow, &config, (axis->current_ref.q > 0) ? f16_neg(u_d) : u_d);
}

static bool moved(const axis_t *axis)
{
    const int32_t way = i32_sub_wrap(axis->feedback.position, axis->search.origin);
    const int32_t least = axis->config->rotor_search.move_counts;
    return way >= least || way <= -least;
}

void stall_proof_slow(axis_t *axis)
{
    const rotor_follow_config_t *config = &axis->config->rotor_search.follow;
    if (moved(axis)) { /* it was held, and the encoder is all right */
        axis_raise(axis, FAULT_STALLED);
    } else if (rotor_follow_step(&axis->search.follow, config)) {
        const bool unseen = rotor_follow_seen(&axis->search.follow, config);
        const fault_set_t found = unseen ? FAULT_ENCODER_LOST & axis->faults_enabled : 0U;
        axis_raise(axis, (found != 0U) ? found : FAULT_STALLED);
    }
    axis->search.vector = axis->search.follow.theta;
}

#include "drive/stall_proof.h"

#include "drive/axis.h"
#include "drive/current_drive.h"

#define GOES_ON_OVER_MOVE 8 /* so much farther, in multiples of a movement that counts: nothing has stopped it */
#define STOPS_TICKS 16U     /* by then, what the torque has left stands; half of them are enough to slow down */
#define TURNS_OVER_MOVE 2   /* back so far from the farthest: more than a bounce */

/* Of this side. */
static rotor_follow_config_t follow_of(const axis_t *axis)
{
    const stall_proof_t *proof = &axis->proof;
    rotor_follow_config_t config = axis->config->rotor_search.follow;
    config.inductive = proof->second ? f16_neg(proof->inductive) : proof->inductive;
    config.step = proof->second ? (uint16_t)(0U - (uint32_t)config.step) : config.step;
    return config;
}

static void turn_to_side(axis_t *axis, bool second)
{
    axis->proof.second = second;
    axis->search.origin = axis->feedback.position;
    rotor_follow_start(&axis->search.follow, 0);
}

void stall_proof_start(axis_t *axis)
{
    const rotor_search_config_t *config = &axis->config->rotor_search;
    const int32_t current = f16_abs(axis->current_ref.q);
    const frac16_t inductive = sat16((int32_t)config->follow.inductive * current / config->current_limit);
    axis->proof = (stall_proof_t){.runs = true, .inductive = inductive};
    axis->search = (rotor_search_t){.phase = ROTOR_SEARCH_TURN};
    axis->search.vector = axis->feedback.theta_e;
    axis->current_ref.d = 0;
    turn_to_side(axis, false);
    current_loop_turn(&axis->current_loop, &axis->config->current_loop, 0);
}

/* The frame turns instead of the rotor, with the current along its q axis: across it lies the d axis. */
void stall_proof_fast(axis_t *axis)
{
    const rotor_follow_config_t config = follow_of(axis);
    drive_current(axis, axis->search.vector);
    const frac16_t u_d = axis->current_loop.voltage.d;
    rotor_follow_add(&axis->search.follow, &config, (axis->current_ref.q > 0) ? f16_neg(u_d) : u_d);
}

static void found(axis_t *axis, fault_set_t fault) { axis_raise(axis, axis_fault_or(axis, fault, FAULT_STALLED)); }

/* Way in the direction of the torque that was wanted. */
static int32_t way_from(const axis_t *axis, int32_t origin)
{
    const int32_t way = i32_sub_wrap(axis->feedback.position, origin);
    return (axis->current_ref.q > 0) ? way : -way;
}

static int32_t least(const axis_t *axis) { return axis->config->rotor_search.move_counts; }

static void turn_step(axis_t *axis)
{
    stall_proof_t *proof = &axis->proof;
    rotor_follow_t *follow = &axis->search.follow;
    const rotor_follow_config_t config = follow_of(axis);
    const int32_t way = way_from(axis, axis->search.origin);
    if (way >= least(axis) || way <= -least(axis)) {
        proof->mirrored = true;
        proof->ahead = way > 0;
        proof->phi = f16_neg(proof->phi);
        proof->ticks = 0;
        proof->farthest = axis->feedback.position;
        axis->search.origin = axis->feedback.position;
        return;
    }
    const bool over = rotor_follow_step(follow, &config);
    proof->phi = follow->theta;
    if (!over) {
        return;
    }
    if (rotor_follow_seen(follow, &config)) {
        found(axis, FAULT_ENCODER_LOST);
    } else if (proof->second) {
        found(axis, FAULT_STALLED);
    } else {
        turn_to_side(axis, true);
    }
}

/* Against the torque: on to where the largest torque of a wrong angle may be. */
static bool turned_out(stall_proof_t *proof, const rotor_follow_config_t *config)
{
    const int32_t most = (int32_t)config->ticks * config->step;
    const int32_t phi = proof->phi + ((proof->phi > 0) ? (int32_t)config->step : -(int32_t)config->step);
    proof->phi = sat16(phi);
    return phi >= most || phi <= -most;
}

static void mirrored_step(axis_t *axis)
{
    stall_proof_t *proof = &axis->proof;
    const int32_t sign = proof->ahead ? 1 : -1;
    const int32_t way = sign * way_from(axis, axis->search.origin);
    const int32_t back = -sign * way_from(axis, proof->farthest);
    proof->farthest = (back < 0) ? axis->feedback.position : proof->farthest;
    proof->ticks++;
    if (proof->ticks == STOPS_TICKS / 2U && proof->ahead) {
        axis->search.origin = proof->farthest;
    }
    if (way >= GOES_ON_OVER_MOVE * least(axis)) {
        found(axis, FAULT_STALLED);
    } else if (back >= TURNS_OVER_MOVE * least(axis)) {
        found(axis, FAULT_ANGLE_MISMATCH);
    } else if (!proof->ahead) {
        if (turned_out(proof, &axis->config->rotor_search.follow)) {
            found(axis, FAULT_STALLED);
        }
    } else if (proof->ticks >= STOPS_TICKS) {
        found(axis, (way >= least(axis)) ? FAULT_STALLED : FAULT_ANGLE_MISMATCH);
    }
}

void stall_proof_slow(axis_t *axis)
{
    if (axis->proof.mirrored) {
        mirrored_step(axis);
    } else {
        turn_step(axis);
    }
    axis->search.vector = f16_add_wrap(axis->feedback.theta_e, axis->proof.phi);
}

#include "diagnosis/stall_test.h"

#define FURTHER_OVER_MOVE 8 /* further movement, in multiples of the detection threshold, that proves a free shaft */
#define STOPS_TICKS 16U /* after this time a shaft without torque has stopped; half of it is enough to decelerate */
#define TURNS_OVER_MOVE 2 /* movement back from the farthest position: larger than a bounce */

/* Parameters of the side in test. */
static rotor_follow_config_t follow_of(const stall_test_t *test, const rotor_search_config_t *config)
{
    rotor_follow_config_t follow = config->follow;
    follow.inductive = test->second_side ? f16_neg(test->inductive) : test->inductive;
    follow.step = test->second_side ? (uint16_t)(0U - (uint32_t)follow.step) : follow.step;
    return follow;
}

static void turn_to_side(stall_test_t *test, bool second, int32_t position)
{
    test->second_side = second;
    test->origin = position;
    rotor_follow_start(&test->follow, 0);
}

void stall_test_start(stall_test_t *test, const rotor_search_config_t *config, const observation_t *observation)
{
    const frac16_t i_q = observation->current_ref.q;
    const int32_t current = f16_abs(i_q);
    *test = (stall_test_t){.running = true, .positive_torque = i_q > 0, .vector_angle = observation->theta_e};
    test->inductive = sat16((int32_t)config->follow.inductive * current / config->current_limit);
    turn_to_side(test, false, observation->count);
}

/* The frame is rotated instead of the rotor, with the current along its q axis: the voltage across the vector is
 * u_d. */
void stall_test_add(stall_test_t *test, const rotor_search_config_t *config, frac16_t u_d)
{
    const rotor_follow_config_t follow = follow_of(test, config);
    rotor_follow_add(&test->follow, &follow, test->positive_torque ? f16_neg(u_d) : u_d);
}

/* Movement in the direction of the commanded torque. */
static int32_t movement_from(const stall_test_t *test, int32_t origin, int32_t position)
{
    const int32_t movement = i32_sub_wrap(position, origin);
    return test->positive_torque ? movement : -movement;
}

/* The vector is being rotated; the shaft has not moved yet. */
static finding_set_t turn_step(stall_test_t *test, const rotor_search_config_t *config, int32_t position)
{
    const rotor_follow_config_t follow = follow_of(test, config);
    const int32_t movement = movement_from(test, test->origin, position);
    if (i32_abs(movement) >= (int32_t)config->move_counts) {
        test->mirrored = true;
        test->with_torque = movement > 0;
        test->phi = f16_neg(test->phi);
        test->ticks = 0;
        test->farthest = position;
        test->origin = position;
        return 0;
    }
    const bool over = rotor_follow_step(&test->follow, &follow);
    test->phi = test->follow.theta;
    if (!over) {
        return 0;
    }
    if (rotor_follow_seen(&test->follow, &follow)) {
        return FOUND(FINDING_STALL_WITHOUT_COUNT);
    }
    if (test->second_side) {
        return FOUND(FINDING_SHAFT_BLOCKED);
    }
    turn_to_side(test, true, position);
    return 0;
}

/* Movement against the torque: rotate the vector on, to the largest angle error at which it may still produce
 * torque. */
static bool turn_outward(stall_test_t *test, const rotor_follow_config_t *config)
{
    const int32_t max = (int32_t)config->ticks * config->step;
    const int32_t phi = test->phi + ((test->phi > 0) ? (int32_t)config->step : -(int32_t)config->step);
    test->phi = sat16(phi);
    return phi >= max || phi <= -max;
}

static finding_set_t mirrored_step(stall_test_t *test, const rotor_search_config_t *config, int32_t position)
{
    const int32_t move_min = config->move_counts;
    const int32_t sign = test->with_torque ? 1 : -1;
    const int32_t movement = sign * movement_from(test, test->origin, position);
    const int32_t back = -sign * movement_from(test, test->farthest, position);
    test->farthest = (back < 0) ? position : test->farthest;
    test->ticks++;
    if (test->ticks == STOPS_TICKS / 2U && test->with_torque) {
        test->origin = test->farthest;
    }
    if (movement >= FURTHER_OVER_MOVE * move_min) {
        return FOUND(FINDING_SHAFT_BLOCKED);
    }
    if (back >= TURNS_OVER_MOVE * move_min) {
        return FOUND(FINDING_STALL_ANGLE_MISMATCH);
    }
    if (!test->with_torque) {
        return turn_outward(test, &config->follow) ? FOUND(FINDING_SHAFT_BLOCKED) : 0U;
    }
    if (test->ticks >= STOPS_TICKS) {
        return (movement >= move_min) ? FOUND(FINDING_SHAFT_BLOCKED) : FOUND(FINDING_STALL_ANGLE_MISMATCH);
    }
    return 0;
}

void stall_test_step(stall_test_t *test, const rotor_search_config_t *config, const observation_t *observation,
                     evidence_t *evidence)
{
    const int32_t position = observation->count;
    evidence->confirmed |= test->mirrored ? mirrored_step(test, config, position) : turn_step(test, config, position);
    test->vector_angle = f16_add_wrap(observation->theta_e, test->phi);
}

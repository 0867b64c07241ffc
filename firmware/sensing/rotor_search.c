#include "sensing/rotor_search.h"

#define HALF_TURN UINT16_C(32768)
#define QUARTER_TURN UINT16_C(16384)
#define GROWTH_MAX UINT16_C(4)
#define LIMIT_OVER_HOLD UINT16_C(4)       /* limits the pull if an edge dithers */
#define STANDSTILL_OVER_REST UINT16_C(10) /* limits the wait likewise; an encoder with a dead channel dithers too */

/* The first count appears after at most one count of movement, the twitch is detected after two or more. With a torque
 * that is constant or grows from zero the time between them is more than a quarter of the time of movement. The
 * deceleration takes at most four times that interval: a longer one would drive back a shaft without friction. */
#define DECELERATE_OVER_MOVING UINT16_C(4)

/* A vector beside theta_M moves the shaft by this factor more: at an end stop this leaves room for the twitch back. */
#define SIDE_OVER_MOVE UINT16_C(2)

/* VERIFY waits for the end of a swing for at most this many hold times. */
#define SWING_OVER_HOLD UINT16_C(8)

/* Speed of the vector in DIRECTION, relative to VERIFY, and its largest step per slow tick. */
#define DIRECTION_OVER_VERIFY UINT16_C(8)
#define DIRECTION_STEP_MAX (QUARTER_TURN / 2U)

/* The direction of the encoder is tested when the shaft has run away from the assumed position this often (once may be a
 * disturbance); the search ends as no movement when it has not followed this often (twice may be a start too close to an
 * end stop). */
#define RUNAWAYS_MAX UINT16_C(2)
#define VERIFY_FAILURES_MAX UINT16_C(3)

/* Movement of the shaft since the start of this pull, as an electrical angle (wraps). */
static frac16_t shift_of(const rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const int64_t moved = (int64_t)i32_sub_wrap(position, search->origin) * config->angle_per_count;
    return (frac16_t)(uint16_t)((uint64_t)(moved + INT64_C(0x8000)) >> 16);
}

/* Counts between two positions. */
static uint32_t distance(int32_t from, int32_t to)
{
    const int32_t moved = i32_sub_wrap(to, from);
    return (moved < 0) ? 0U - (uint32_t)moved : (uint32_t)moved;
}

/* theta_M plus a multiple of an angle. */
static frac16_t beside(const rotor_search_t *search, int16_t times, uint16_t angle)
{
    return (frac16_t)(uint16_t)((uint16_t)search->theta_m + (uint32_t)(uint16_t)times * angle);
}

/* Angle of the vector for a shaft at the position where this pull began. */
static frac16_t aim(const rotor_search_t *search) { return beside(search, search->side, QUARTER_TURN); }

/* The torque is the current times the sine of the angle between rotor and vector; the bounds give the smallest possible
 * sine. Faster growth of the current compensates for it in part: full compensation would leave too few slow ticks for
 * the deceleration. */
static frac32_t growth(const rotor_search_t *search, const rotor_search_config_t *config)
{
    int64_t step = config->current_step;
    if (search->side == 0 && search->reach < QUARTER_TURN) {
        step *= (search->reach >= QUARTER_TURN / GROWTH_MAX) ? QUARTER_TURN / search->reach : GROWTH_MAX;
    }
    return (step < config->current_slew) ? (frac32_t)step : config->current_slew;
}

/* Next current of the ramp to `target`, at the slew rate that the current controller follows. */
static frac32_t slew(const rotor_search_t *search, const rotor_search_config_t *config, frac32_t target)
{
    return (frac32_t)(search->current + f32_limit((int64_t)target - search->current, config->current_slew));
}

static void pull(rotor_search_t *search, int32_t position)
{
    search->phase = ROTOR_SEARCH_PULL;
    search->vector = aim(search);
    search->current = 0;
    search->origin = position;
    search->last_position = position;
    search->timer = 0;
    search->ticks_at_limit = 0;
    search->moving = 0;
    search->direction = 0;
    search->low_current_periods = 0;
    search->searches++;
}

static void rest(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    search->phase = ROTOR_SEARCH_REST;
    search->current = slew(search, config, 0);
    search->current_decaying = true;
    search->last_position = position;
    search->timer = 0;
    search->reference_position = position;
    search->ticks_without_movement = 0;
}

static void finish(rotor_search_t *search, rotor_search_phase_t phase)
{
    search->phase = phase;
    search->current = 0;
}

void rotor_search_start(rotor_search_t *search, int32_t position)
{
    *search = (rotor_search_t){.reach = HALF_TURN};
    pull(search, position);
}

/* Verify the assumed rotor angle theta_M; the current may still be that of the pull. */
static void verify(rotor_search_t *search, int32_t position)
{
    search->phase = ROTOR_SEARCH_VERIFY;
    search->vector = search->theta_m;
    search->origin = position;
    search->reference_position = position;
    search->direction = 1;
    search->follows = false;
    search->last_position = position;
    search->ticks_at_limit = 0;
}

/* The current grows from its present value. */
static void test_direction(rotor_search_t *search, int32_t position)
{
    search->phase = ROTOR_SEARCH_DIRECTION;
    search->origin = position;
    search->timer = 0;
    search->half_turns_sum = 0;
}

/* The assumed position is wrong and there is no other candidate: try from the side, or give up. */
static void reject_position(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    if (search->runaways < RUNAWAYS_MAX && search->verify_failures >= VERIFY_FAILURES_MAX) {
        finish(search, ROTOR_SEARCH_NO_MOVEMENT);
    } else {
        search->reach = HALF_TURN;
        search->side = 1;
        search->direction = 0;
        rest(search, config, position);
    }
}

/* No movement at full current. After a twitch the rotor should lie on the vector. Without one it may also lie opposite
 * to it: vectors at either side decide, one after the other, because the shaft may be against an end stop. */
static void handle_no_movement(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    if (search->side == 0 && search->reach <= QUARTER_TURN) {
        search->theta_m = f16_add_wrap(search->theta_m, shift_of(search, config, position));
        verify(search, position);
    } else if (search->side >= 0) {
        search->side = (search->side == 0) ? 1 : -1;
        rest(search, config, position);
    } else {
        search->phase = ROTOR_SEARCH_TURN;
        search->origin = position;
        rotor_follow_start(&search->follow, search->vector);
    }
}

/* Reverse the current in equal steps, which cancel each other, within the slew rate of the current controller. */
static void decelerate(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const uint32_t reversal = 2U * (uint32_t)search->current; /* not negative during a pull */
    const uint32_t steps = reversal / (uint32_t)config->current_slew + 1U;
    search->phase = ROTOR_SEARCH_DECELERATE;
    search->last_position = position;
    search->timer = 0;
    search->reversed_current = -search->current;
    search->reversal_step = (frac32_t)(reversal / steps + ((reversal % steps != 0U) ? 1U : 0U));
    search->current -= search->reversal_step;
}

static void pull_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const uint32_t moved = distance(search->origin, position);
    search->vector = f16_add_wrap(aim(search), shift_of(search, config, position));
    search->moving = (moved == 0U) ? 0U : (uint16_t)(search->moving + 1U);
    if (moved >= (uint32_t)config->move_counts * ((search->side != 0) ? SIDE_OVER_MOVE : 1U)) {
        search->direction = (i32_sub_wrap(position, search->origin) > 0) ? 1 : -1;
        decelerate(search, config, position);
        return;
    }
    const frac32_t limit = f32_from_f16(config->current_limit);
    search->timer = (position == search->last_position) ? (uint16_t)(search->timer + 1U) : 0U;
    search->last_position = position;
    if (search->current < limit) {
        search->current = f32_limit((int64_t)search->current + growth(search, config), limit);
        search->timer = 0;
        return;
    }
    search->ticks_at_limit++;
    if (search->timer >= config->hold_ticks ||
        search->ticks_at_limit >= (uint32_t)LIMIT_OVER_HOLD * config->hold_ticks) {
        handle_no_movement(search, config, position);
    }
}

/* Mirrors the pull with reversed current, until the shaft turns back or the speed gained by the pull is cancelled. */
static void decelerate_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const int32_t ahead = i32_sub_wrap(position, search->last_position);
    const bool back = (search->direction > 0) ? ahead < 0 : ahead > 0;
    search->vector = f16_add_wrap(aim(search), shift_of(search, config, position));
    search->last_position = position;
    search->timer++;
    bool complete = false;
    if (search->current > search->reversed_current) {
        const frac32_t next = search->current - search->reversal_step;
        search->current = (next > search->reversed_current) ? next : search->reversed_current;
    } else if (search->ticks_at_limit > 0U) {
        search->ticks_at_limit--;
    } else {
        search->reversed_current = f32_add(search->reversed_current, growth(search, config));
        complete = search->reversed_current >= 0;
        search->current = complete ? 0 : search->reversed_current;
    }
    if (back || complete || search->timer >= (uint32_t)DECELERATE_OVER_MOVING * search->moving) {
        rest(search, config, position);
    }
}

/* The direction of the twitch halves the interval of possible angles: after a positive twitch the rotor was below the
 * vector. */
static void halve(rotor_search_t *search)
{
    search->reach = (uint16_t)(search->reach >> 1);
    search->theta_m = beside(search, (int16_t)-search->direction, search->reach);
}

/* A vector beside theta_M has moved the shaft: the rotor lies within a quarter turn of theta_M, or of the opposite
 * angle. */
static void decide_side(rotor_search_t *search)
{
    search->theta_m = beside(search, (search->direction == search->side) ? 0 : 2, QUARTER_TURN);
    search->reach = QUARTER_TURN;
    search->side = 0;
}

static void rest_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    if (search->current != 0) {
        search->current = slew(search, config, 0);
    } else {
        search->current_decaying = false;
    }
    search->timer = (position == search->last_position) ? (uint16_t)(search->timer + 1U) : 0U;
    search->last_position = position;
    if (distance(search->reference_position, position) > 1U) {
        search->reference_position = position;
        search->ticks_without_movement = 0;
    }
    search->ticks_without_movement++;
    /* A shaft without friction would coast on: it is accepted while it moves. */
    const bool coasts = search->verified && distance(search->origin, position) > 2U * config->move_counts;
    const bool rests = search->timer >= config->rest_ticks ||
                       search->ticks_without_movement >= (uint32_t)STANDSTILL_OVER_REST * config->rest_ticks;
    if (!rests && !coasts) {
        return;
    }
    if (search->verified) {
        search->vector = f16_add_wrap(search->theta_m, shift_of(search, config, position));
        finish(search, ROTOR_SEARCH_FOUND);
        return;
    }
    if (search->runaways >= RUNAWAYS_MAX) {
        test_direction(search, position);
        return;
    }
    if (search->direction != 0 && search->side != 0) {
        decide_side(search);
    } else if (search->direction != 0) {
        halve(search);
    }
    search->theta_m = f16_add_wrap(search->theta_m, shift_of(search, config, position)); /* coordinate correction */
    if (2 * (int32_t)search->reach > config->interval) {
        pull(search, position);
    } else {
        verify(search, position);
    }
}

/* Full current on the assumed angle, until the shaft does not swing any more. */
static void hold_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const frac32_t limit = f32_from_f16(config->current_limit);
    const bool full = search->current >= limit;
    search->ticks_at_limit += full ? 1U : 0U;
    const bool swings = distance(search->last_position, position) > 1U &&
                        search->ticks_at_limit < (uint32_t)SWING_OVER_HOLD * config->hold_ticks;
    search->timer = (uint16_t)((full && !swings) ? search->timer + 1U : 0U);
    if (!full || swings) {
        search->last_position = position;
    }
    search->reference_position = position;
    search->current = f32_limit((int64_t)search->current + growth(search, config), limit);
}

/* Rotate the vector to one side until the shaft has followed, then back until the shaft has returned; if it does not
 * follow, to the other side. Friction contributes to the angle between vector and assumed rotor angle; the mean of both
 * directions is the error of the assumed angle. */
static void verify_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const frac32_t limit = f32_from_f16(config->current_limit);
    const frac16_t rotor = f16_add_wrap(search->theta_m, shift_of(search, config, position));
    const frac16_t ahead = f16_sub_wrap(search->vector, rotor);
    const int64_t gone = (int64_t)distance(search->origin, position) * config->angle_per_count;
    if (gone > (int64_t)QUARTER_TURN << 16) { /* farther than a swing from the largest error that is corrected here */
        search->runaways++;
        reject_position(search, config, position);
        return;
    }
    if (search->current < limit || search->timer < config->hold_ticks) {
        hold_step(search, config, position);
        return;
    }
    const int32_t moved = search->direction * i32_sub_wrap(position, search->reference_position);
    const int16_t sign = (int16_t)(search->follows ? -search->direction : search->direction);
    if (search->follows ? moved > 0 : moved < (int32_t)config->move_counts) {
        if ((int32_t)sign * f16_sub_wrap(search->vector, search->theta_m) < (int32_t)config->verify_angle) {
            search->vector = f16_add_wrap(search->vector, (frac16_t)(sign * (int16_t)config->verify_step));
        } else if (sign > 0 && !search->follows) {
            search->direction = -1;
        } else {
            search->verify_failures++;
            reject_position(search, config, position);
        }
    } else if (!search->follows) {
        search->follows = true;
        search->lead_angle = ahead;
    } else {
        search->theta_m = f16_add_wrap(rotor, (frac16_t)(((int32_t)search->lead_angle + ahead) / 2));
        search->origin = position;
        search->verified = true;
        rest(search, config, position); /* the shaft has just moved: wait for standstill before the hand-over */
    }
}

/* Rotate the vector by three half turns. In the first one the shaft locks to the vector. The mean position in the third
 * minus that in the second is half a turn, in the direction in which the encoder counts; swings of the shaft cancel. */
static void direction_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const frac32_t limit = f32_from_f16(config->current_limit);
    if (search->current < limit) {
        search->current = f32_limit((int64_t)search->current + config->current_step, limit);
        return;
    }
    const uint32_t wanted = (uint32_t)DIRECTION_OVER_VERIFY * config->verify_step;
    const uint16_t step = (uint16_t)((wanted < DIRECTION_STEP_MAX) ? wanted : DIRECTION_STEP_MAX);
    const uint16_t half = (uint16_t)(HALF_TURN / step);
    const int32_t moved = i32_sub_wrap(position, search->origin);
    search->vector = f16_add_wrap(search->vector, (frac16_t)step);
    if (search->timer >= half) {
        search->half_turns_sum =
            f32_add(search->half_turns_sum, (search->timer < 2U * (uint32_t)half) ? -moved : moved);
    }
    search->timer++;
    if (search->timer >= 3U * (uint32_t)half) {
        const int64_t quarter = ((int64_t)QUARTER_TURN << 16) * half;
        const int64_t back = -(int64_t)search->half_turns_sum * config->angle_per_count;
        const bool against = back > quarter && back < 3 * quarter;
        finish(search, against ? ROTOR_SEARCH_REVERSED : ROTOR_SEARCH_NO_MOVEMENT);
    }
}

static void turn_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    if (distance(search->origin, position) >= config->move_counts) { /* free again, and counted */
        search->verify_failures++;
        reject_position(search, config, position);
        return;
    }
    const bool back = rotor_follow_step(&search->follow, &config->follow);
    search->vector = search->follow.theta;
    if (back) {
        const bool seen = rotor_follow_seen(&search->follow, &config->follow);
        finish(search, seen ? ROTOR_SEARCH_NO_COUNT : ROTOR_SEARCH_NO_MOVEMENT);
    }
}

void rotor_search_add(rotor_search_t *search, const rotor_search_config_t *config, frac16_t current, frac16_t u_across)
{
    if (search->phase == ROTOR_SEARCH_TURN) {
        rotor_follow_add(&search->follow, &config->follow, u_across);
    }
    /* Detects an open motor cable: less than a quarter of the current flows, in either sign. A strong motor's rotor
     * that swings with a dead encoder disturbs the current too, but does not suppress it. */
    const bool much = search->current >= f32_from_f16(config->current_limit) / 4;
    const bool low_current = much && f32_abs(f32_from_f16(current)) < search->current / 4;
    search->low_current_periods = low_current ? (uint16_t)(search->low_current_periods + 1U) : 0U;
}

void rotor_search_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    if (search->low_current_periods >= ROTOR_SEARCH_LOW_CURRENT_MAX) {
        finish(search, ROTOR_SEARCH_LOW_CURRENT);
        return;
    }
    switch (search->phase) {
    case ROTOR_SEARCH_PULL:
        pull_step(search, config, position);
        break;
    case ROTOR_SEARCH_DECELERATE:
        decelerate_step(search, config, position);
        break;
    case ROTOR_SEARCH_REST:
        rest_step(search, config, position);
        break;
    case ROTOR_SEARCH_VERIFY:
        verify_step(search, config, position);
        break;
    case ROTOR_SEARCH_DIRECTION:
        direction_step(search, config, position);
        break;
    case ROTOR_SEARCH_TURN:
        turn_step(search, config, position);
        break;
    default:
        break;
    }
}

bool rotor_search_tests_direction(rotor_search_t *search, int32_t position)
{
    if (search->phase != ROTOR_SEARCH_DIRECTION && search->runaways > 0U) {
        test_direction(search, position);
    }
    return search->phase == ROTOR_SEARCH_DIRECTION;
}

bool rotor_search_drives(const rotor_search_t *search)
{
    return search->phase == ROTOR_SEARCH_PULL || search->phase == ROTOR_SEARCH_DECELERATE ||
           search->phase == ROTOR_SEARCH_VERIFY || search->phase == ROTOR_SEARCH_DIRECTION ||
           search->phase == ROTOR_SEARCH_TURN || search->phase == ROTOR_SEARCH_HOLD ||
           (search->phase == ROTOR_SEARCH_REST && search->current_decaying);
}

frac16_t rotor_search_angle(const rotor_search_t *search) { return search->vector; }

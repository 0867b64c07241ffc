#include "sensing/rotor_search.h"

#define HALF_TURN UINT16_C(32768)
#define QUARTER_TURN UINT16_C(16384)
#define GROWTH_MOST UINT16_C(4)
#define HELD_OVER_HOLD UINT16_C(4)  /* an edge that dithers is no reason to pull for ever */
#define CALM_OVER_REST UINT16_C(10) /* nor to wait; so dithers an encoder with a dead line, too */
#define FADE_TICKS UINT16_C(4) /* 2 ms: shorted windings would lose their current with L / R, and go on pulling */
#define STARVED_MOST UINT16_C(64) /* PWM periods: 4 ms */

/* The first count comes after one count of movement at most, the twitch after two or more. With a torque that is constant
 * or grows from zero, the time in between is more than a quarter of the movement's; the brake takes no longer than that. */
#define BRAKE_OVER_MOVING UINT16_C(4)

/* So many twitches in a row in one direction: the bound on the other side dates from before them. */
#define RUN_LEAST 2

/* A rotor beyond a bound is looked for within so many reaches, as a power of two, of the end of a search. */
#define BEYOND_SHIFT 5

/* What the shaft has moved since the start of this pull, electrical, wrapped as all angles are. */
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

/* theta_M and so many times an angle. */
static frac16_t beside(const rotor_search_t *search, int16_t times, uint16_t angle)
{
    return (frac16_t)(uint16_t)((uint16_t)search->theta_m + (uint32_t)(uint16_t)times * angle);
}

/* Angle of the vector while the shaft stands where this pull has begun. */
static frac16_t aim(const rotor_search_t *search)
{
    return (search->check != 0) ? beside(search, search->check, search->reach)
                                : beside(search, search->side, QUARTER_TURN);
}

/* The torque is the current times the sine of the angle between rotor and vector, and the bounds say how small that may
 * be: a faster growth makes up for it in part. In full it would leave the brake too few slow ticks. */
static frac32_t growth(const rotor_search_t *search, const rotor_search_config_t *config)
{
    int64_t step = config->current_step;
    if (search->side == 0 && search->reach < QUARTER_TURN) {
        step *= (search->reach >= QUARTER_TURN / GROWTH_MOST) ? QUARTER_TURN / search->reach : GROWTH_MOST;
    }
    return (step < config->current_slew) ? (frac32_t)step : config->current_slew;
}

/* As far towards a current as the current controller follows. */
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
    search->last = position;
    search->timer = 0;
    search->held = 0;
    search->moving = 0;
    search->direction = 0;
    search->starved = 0;
    search->searches++;
}

static void rest(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    search->phase = ROTOR_SEARCH_REST;
    search->current = slew(search, config, 0);
    search->fade = FADE_TICKS;
    search->last = position;
    search->timer = 0;
    search->anchor = position;
    search->calm = 0;
}

static void finish(rotor_search_t *search, rotor_search_phase_t phase)
{
    search->phase = phase;
    search->current = 0;
}

/* Nothing is known. */
static void forget(rotor_search_t *search)
{
    search->theta_m = 0;
    search->reach = HALF_TURN;
    search->direction = 0;
    search->run = 0;
    search->side = 0;
    search->check = 0;
    search->free = false;
}

void rotor_search_start(rotor_search_t *search, int32_t position)
{
    *search = (rotor_search_t){0};
    forget(search);
    pull(search, position);
}

/* The largest current has moved nothing. The rotor lies on the vector if the shaft has been seen to be free since the last
 * twitch; and it does not matter if the bounds are as narrow as they have to become. Otherwise vectors from the sides
 * tell, first one, then - the shaft may lean on an end stop - the other. */
static void nothing_moved(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    if (search->side == 0) {
        if (search->free || (int32_t)search->reach <= config->interval) {
            finish(search, ROTOR_SEARCH_FOUND);
            return;
        }
        search->side = 1;
    } else if (search->side == 1) {
        search->side = -1;
    } else {
        search->phase = ROTOR_SEARCH_TURN;
        search->origin = position;
        rotor_follow_start(&search->follow, search->vector);
        return;
    }
    rest(search, config, position);
}

/* The current is reversed in equal steps, which cancel out, as far each as the current controller follows. */
static void brake(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const uint32_t reversal = 2U * (uint32_t)search->current; /* while it pulls it is not negative */
    const uint32_t steps = reversal / (uint32_t)config->current_slew + 1U;
    search->phase = ROTOR_SEARCH_BRAKE;
    search->pace = distance(search->last, position);
    search->last = position;
    search->timer = 0;
    search->peak = -search->current;
    search->swing = (frac32_t)(reversal / steps + ((reversal % steps != 0U) ? 1U : 0U));
    search->current -= search->swing;
}

static void pull_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const uint32_t moved = distance(search->origin, position);
    search->vector = f16_add_wrap(aim(search), shift_of(search, config, position));
    search->moving = (moved == 0U) ? 0U : (uint16_t)(search->moving + 1U);
    /* Where it is believed to lie nothing must move it: not even back to an end stop that it has just been pulled off. */
    const uint16_t twitch = (uint16_t)(config->move_counts - (search->free ? 1U : 0U));
    if (moved >= twitch) {
        search->direction = (i32_sub_wrap(position, search->origin) > 0) ? 1 : -1;
        brake(search, config, position);
        return;
    }
    const frac32_t limit = f32_from_f16(config->current_limit);
    search->timer = (position == search->last) ? (uint16_t)(search->timer + 1U) : 0U;
    search->last = position;
    if (search->current < limit) {
        search->current = f32_limit((int64_t)search->current + growth(search, config), limit);
        search->timer = 0;
        return;
    }
    search->held++;
    if (search->timer >= config->hold_ticks || search->held >= (uint32_t)HELD_OVER_HOLD * config->hold_ticks) {
        nothing_moved(search, config, position);
    }
}

/* Until the shaft turns back, or has lost what it had won: the pull backwards, with the current reversed. */
static void brake_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const int32_t ahead = i32_sub_wrap(position, search->last);
    const bool back = (search->direction > 0) ? ahead < 0 : ahead > 0;
    /* On a vector within a count of the rotor, the reversed current may drive it on instead. */
    const bool driven = distance(search->last, position) > 2U * search->pace + 1U;
    search->vector = f16_add_wrap(aim(search), shift_of(search, config, position));
    search->last = position;
    search->timer++;
    bool spent = false;
    if (search->current > search->peak) {
        const frac32_t next = search->current - search->swing;
        search->current = (next > search->peak) ? next : search->peak;
    } else if (search->held > 0U) {
        search->held--;
    } else {
        search->peak = f32_add(search->peak, growth(search, config));
        spent = search->peak >= 0;
        search->current = spent ? 0 : search->peak;
    }
    if (back || driven || spent || search->timer >= (uint32_t)BRAKE_OVER_MOVING * search->moving) {
        rest(search, config, position);
    }
}

/* The direction of the twitch halves the bounds: pulled upwards, the rotor was below the vector. */
static void halve(rotor_search_t *search)
{
    search->reach = (uint16_t)(search->reach >> 1);
    search->theta_m = beside(search, (int16_t)-search->direction, search->reach);
    const bool again = (search->direction > 0) ? search->run > 0 : search->run < 0;
    search->run = (int16_t)(again ? search->run + search->direction : search->direction);
    search->free = false;
}

/* A vector beside theta_M has moved the shaft: the rotor lies within a quarter turn of theta_M, or of its opposite. */
static void decide_side(rotor_search_t *search)
{
    const bool opposite = search->direction != search->side;
    if (opposite && search->reach <= QUARTER_TURN) {
        forget(search); /* that is outside of the bounds: one of the twitches was none of ours */
        return;
    }
    search->theta_m = beside(search, opposite ? 2 : 0, QUARTER_TURN);
    search->reach = (search->reach < QUARTER_TURN) ? search->reach : QUARTER_TURN;
    search->side = 0;
    search->free = true;
}

/* A vector at a bound has moved the shaft: inwards, and that bound holds, or outwards, and the rotor lies beyond it. */
static bool decide_check(rotor_search_t *search)
{
    if (search->direction == search->check) {
        return true;
    }
    const uint16_t beyond = (uint16_t)(search->reach << BEYOND_SHIFT);
    search->theta_m = beside(search, search->check, (uint16_t)(search->reach + beyond));
    search->reach = beyond;
    search->check = 0;
    search->run = 0;
    return false;
}

/* What the twitch means. True when the rotor is found. */
static bool decide(rotor_search_t *search, const rotor_search_config_t *config)
{
    if (search->direction == 0) {
        return false; /* theta_M has only been left for its side */
    }
    if (search->side != 0) {
        decide_side(search);
        return false;
    }
    if (search->check != 0) {
        return decide_check(search);
    }
    halve(search);
    if (2 * (int32_t)search->reach > config->interval) {
        return false;
    }
    if (search->run > -RUN_LEAST && search->run < RUN_LEAST) {
        return true;
    }
    search->check = (search->run > 0) ? -1 : 1; /* the bound that the rotor has been going to */
    return false;
}

static void rest_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    if (search->current != 0) {
        if (search->current < 0) { /* a reversed vector that stood still would push the shaft away from it */
            search->vector = f16_add_wrap(aim(search), shift_of(search, config, position));
        }
        search->current = slew(search, config, 0);
    } else if (search->fade > 0U) {
        search->fade--;
    }
    search->timer = (position == search->last) ? (uint16_t)(search->timer + 1U) : 0U;
    search->last = position;
    if (distance(search->anchor, position) > 1U) {
        search->anchor = position;
        search->calm = 0;
    }
    search->calm++;
    if (search->timer < config->rest_ticks && search->calm < (uint32_t)CALM_OVER_REST * config->rest_ticks) {
        return;
    }
    const bool found = decide(search, config);
    search->theta_m = f16_add_wrap(search->theta_m, shift_of(search, config, position)); /* coordinate correction */
    if (found) {
        search->vector = search->theta_m;
        finish(search, ROTOR_SEARCH_FOUND);
    } else {
        pull(search, position);
    }
}

static void turn_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    if (distance(search->origin, position) >=
        config->move_counts) { /* the shaft has come free, and the encoder sees it */
        forget(search);
        rest(search, config, position);
        return;
    }
    const bool back = rotor_follow_step(&search->follow, &config->follow);
    search->vector = search->follow.theta;
    if (back) {
        const bool seen = rotor_follow_seen(&search->follow, &config->follow);
        finish(search, seen ? ROTOR_SEARCH_BLIND : ROTOR_SEARCH_HELD);
    }
}

void rotor_search_watch(rotor_search_t *search, const rotor_search_config_t *config, frac16_t current,
                        frac16_t u_across)
{
    if (search->phase == ROTOR_SEARCH_TURN) {
        rotor_follow_add(&search->follow, &config->follow, u_across);
    }
    /* An open motor cable. A quarter, of either sign: the rotor of a strong motor that swings unseen upsets the current
     * too, but does not take it away. */
    const bool much = search->current >= f32_from_f16(config->current_limit) / 4;
    const bool starved = much && f32_abs(f32_from_f16(current)) < search->current / 4;
    search->starved = starved ? (uint16_t)(search->starved + 1U) : 0U;
}

void rotor_search_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    if (search->starved >= STARVED_MOST) {
        finish(search, ROTOR_SEARCH_HELD);
        search->starved = 0;
        return;
    }
    switch (search->phase) {
    case ROTOR_SEARCH_PULL:
        pull_step(search, config, position);
        break;
    case ROTOR_SEARCH_BRAKE:
        brake_step(search, config, position);
        break;
    case ROTOR_SEARCH_REST:
        rest_step(search, config, position);
        break;
    case ROTOR_SEARCH_TURN:
        turn_step(search, config, position);
        break;
    default:
        break;
    }
}

bool rotor_search_drives(const rotor_search_t *search)
{
    return search->phase == ROTOR_SEARCH_PULL || search->phase == ROTOR_SEARCH_BRAKE ||
           search->phase == ROTOR_SEARCH_TURN || (search->phase == ROTOR_SEARCH_REST && search->fade > 0U);
}

frac16_t rotor_search_angle(const rotor_search_t *search) { return search->vector; }

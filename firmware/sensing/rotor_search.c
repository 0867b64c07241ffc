#include "sensing/rotor_search.h"

#define TURN INT32_C(65536)
#define NARROW (TURN / 6) /* bounds within which "nothing moved" means "found" */

static void pull(rotor_search_t *search, int32_t position)
{
    search->phase = ROTOR_SEARCH_PULL;
    search->current = 0;
    search->origin = position;
    search->timer = 0;
    search->direction = 0;
    search->searches++;
}

static void rest(rotor_search_t *search, int32_t position)
{
    search->phase = ROTOR_SEARCH_REST;
    search->current = 0;
    search->rest_position = position;
    search->timer = 0;
}

void rotor_search_start(rotor_search_t *search, int32_t position)
{
    search->theta_l = -TURN / 2;
    search->theta_m = 0;
    search->theta_h = TURN / 2;
    search->searches = 0;
    search->from_side = false;
    pull(search, position);
}

/* The largest current has moved nothing. Within narrow bounds the rotor then lies on theta_M. Within wide ones it may as
 * well lie opposite, where there is no torque either, or be held fast: a vector from the side tells. */
static void nothing_moved(rotor_search_t *search, int32_t position)
{
    if (search->from_side) {
        search->phase = ROTOR_SEARCH_FAILED;
        search->current = 0;
    } else if (search->theta_h - search->theta_l <= NARROW) {
        search->phase = ROTOR_SEARCH_FOUND;
        search->current = 0;
    } else {
        search->from_side = true;
        search->theta_m += TURN / 4;
        rest(search, position);
    }
}

static void pull_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const int32_t moved = i32_sub_wrap(position, search->origin);
    const int32_t distance = (moved < 0) ? -moved : moved;
    if (distance >= (int32_t)config->move_counts) {
        search->direction = (moved > 0) ? 1 : -1;
        rest(search, position);
        return;
    }
    const frac32_t limit = f32_from_f16(config->current_limit);
    search->current = f32_limit((int64_t)search->current + config->current_step, limit);
    if (search->current < limit) {
        return;
    }
    search->timer++;
    if (search->timer > config->hold_ticks) {
        nothing_moved(search, position);
    }
}

/* The direction of the twitch halves the bounds; then they go with the shaft (coordinate correction). */
static void halve(rotor_search_t *search, int32_t shift)
{
    if (search->direction == 0) {
        return; /* nothing is known yet; theta_M has been turned to the side */
    }
    if (search->from_side) {
        /* The rotor lay a quarter turn below or above this vector. */
        search->theta_l = search->theta_m - search->direction * (TURN / 4);
        search->theta_h = search->theta_l;
    } else if (search->direction > 0) {
        search->theta_h = search->theta_m; /* pulled upwards: the rotor was below the vector */
    } else {
        search->theta_l = search->theta_m;
    }
    search->theta_l += shift;
    search->theta_h += shift;
    search->theta_m = asr32(search->theta_l + search->theta_h, 1);
}

static void rest_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    if (position != search->rest_position) {
        rest(search, position);
        return;
    }
    search->timer++;
    if (search->timer < config->rest_ticks) {
        return;
    }
    const int64_t moved = (int64_t)i32_sub_wrap(position, search->origin) * config->angle_per_count;
    halve(search, (int32_t)asr64(moved + INT64_C(0x8000), 16));
    if (search->theta_h - search->theta_l <= config->interval) {
        search->phase = ROTOR_SEARCH_FOUND;
    } else {
        pull(search, position);
    }
}

void rotor_search_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    if (search->phase == ROTOR_SEARCH_PULL) {
        pull_step(search, config, position);
    } else if (search->phase == ROTOR_SEARCH_REST) {
        rest_step(search, config, position);
    }
}

frac16_t rotor_search_angle(const rotor_search_t *search) { return (frac16_t)(uint16_t)search->theta_m; }

#include "sensing/rotor_search.h"

#define TURN INT32_C(65536)

static void pull(rotor_search_t *search, int32_t position)
{
    search->phase = ROTOR_SEARCH_PULL;
    search->current = 0;
    search->origin = position;
    search->timer = 0;
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
    search->moved = false;
    search->second_try = false;
    pull(search, position);
}

/* The largest current has moved nothing. */
static void nothing_moved(rotor_search_t *search, int32_t position)
{
    if (search->moved || search->second_try) {
        /* The rotor lies on theta_M, or, when even two vectors at right angles moved nothing, it is held fast. */
        search->phase = search->moved ? ROTOR_SEARCH_FOUND : ROTOR_SEARCH_FAILED;
        search->current = 0;
        return;
    }
    /* At 180 degrees from the first vector there is no torque either: ask again from the side. */
    search->second_try = true;
    search->theta_m = TURN / 4;
    search->theta_l = search->theta_m - TURN / 2;
    search->theta_h = search->theta_m + TURN / 2;
    rest(search, position);
}

static void pull_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const int32_t moved = i32_sub_wrap(position, search->origin);
    const int32_t distance = (moved < 0) ? -moved : moved;
    if (distance >= (int32_t)config->move_counts) {
        if (moved > 0) {
            search->theta_h = search->theta_m; /* pulled upwards: the rotor was below the vector */
        } else {
            search->theta_l = search->theta_m;
        }
        search->moved = true;
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
    /* Coordinate correction: the bounds go with the shaft. */
    const int64_t moved = (int64_t)i32_sub_wrap(position, search->origin) * config->angle_per_count;
    const int32_t shift = (int32_t)asr64(moved + INT64_C(0x8000), 16);
    search->theta_l += shift;
    search->theta_h += shift;
    search->theta_m = asr32(search->theta_l + search->theta_h, 1);
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

#include "sensing/rotor_hold.h"

#include "math/trig.h"

typedef enum {
    STAGE_RISE,   /* the brake is closed, the current rises */
    STAGE_CATCH,  /* the brake opens */
    STAGE_AWAY,   /* check: the shaft must follow a small rotation of the vector */
    STAGE_BACK,   /* back to the original position */
    STAGE_WEAKEN, /* reduction to half of the current */
} rotor_hold_stage_t;

/* Let a be the largest acceleration of the electrical angle per slow tick squared, and the vector at -(P x + D dx): the
 * shaft is then a second-order system with omega^2 = a (1 + P) and 2 zeta omega = D a. A rotor that starts opposite to
 * the vector accelerates until the vector has turned by half a turn; more damping shortens this. D a = 0.7 allows for
 * an inertia of half the assumed one; D above 80 amplifies a single count too much. */
#define GAIN 2
#define DAMPING_TIMES_ACCELERATION UINT32_C(7301) /* 0.7 / 2 pi x 2^16 */
#define DAMPING_MAX UINT32_C(80)
#define DAMPED_PARTS 3 /* parts of D; one of them applies to the first count */
#define INTEGRAL_SHIFT 3 /* fraction of P, per slow tick */

#define AWAY_OVER_MOVE 8 /* small rotation, in multiples of the detection threshold */
/* Loss of control: half a turn away from the original position, or an eighth after the shaft has been caught; 2^32 is a
 * turn. */
#define DISPLACEMENT_MAX (INT64_C(1) << 31)
#define DISPLACEMENT_MAX_CAUGHT (INT64_C(1) << 29)

void rotor_hold_start(rotor_search_t *search, const rotor_search_config_t *config, int32_t position,
                      int32_t acceleration)
{
    const int64_t counts = (int64_t)acceleration * config->current_limit; /* 37 fraction bits */
    const int64_t angle = asr64(asr64(counts, 16) * config->angle_per_count, 37); /* 2^16 is a turn */
    const uint32_t a = (angle > 1) ? (uint32_t)angle : 1U;
    const uint32_t damping = DAMPING_TIMES_ACCELERATION / a;
    *search = (rotor_search_t){
        .phase = ROTOR_SEARCH_HOLD,
        .origin = position,
        .last_position = position,
        .damping = (uint16_t)((damping < DAMPING_MAX) ? damping : DAMPING_MAX),
        .searches = 1,
    };
}

bool rotor_hold_opens_brake(const rotor_search_t *search)
{
    return search->phase == ROTOR_SEARCH_HOLD && search->stage != (uint16_t)STAGE_RISE;
}

static frac16_t upper(uint32_t angle) { return (frac16_t)(uint16_t)(angle >> 16); }

/* phi_1 of sin(phi_1 + rotation) = 2 sin(phi_1): tan(phi_1) = sin(rotation) / (2 - cos(rotation)). */
static frac16_t lead(frac16_t rotation)
{
    const sin_cos_t r = sin_cos(rotation);
    return f16_angle((frac16_t)((INT32_C(65536) - r.cos) / 4), (frac16_t)(r.sin / 4));
}

static void found(rotor_search_t *search)
{
    const frac16_t rotation = f16_sub_wrap(search->vector, search->lead_angle);
    const frac16_t behind = f16_add_wrap(lead(rotation), rotation);
    const frac16_t across = sat16(sin_cos(behind).sin);
    search->vector = f16_sub_wrap(search->vector, behind);
    search->current = f32_from_f16(f16_mul(f16_from_f32(search->current), across));
    search->phase = ROTOR_SEARCH_FOUND;
}

static void next(rotor_search_t *search, rotor_hold_stage_t stage)
{
    search->stage = (uint16_t)stage;
    search->timer = 0;
    search->ticks_without_movement = 0;
}

/* Turn the vector against the displacement of the shaft. Returns the number of slow ticks for which the shaft has been
 * at its original position. */
static uint16_t balance(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const int32_t off = i32_sub_wrap(position, search->origin);
    const int32_t moved = i32_sub_wrap(position, search->last_position);
    const uint32_t per_count = (uint32_t)config->angle_per_count;
    const uint32_t angle = (uint32_t)off * per_count; /* modulo a turn, like the vector */
    search->balance_angle -= (uint32_t)(off * (int32_t)(per_count >> INTEGRAL_SHIFT)); /* below a turn */
    const int32_t first = (moved > 0) - (moved < 0); /* less damping for this count prevents dither */
    const int32_t rate = DAMPED_PARTS * moved - (DAMPED_PARTS - 1) * first;
    const uint32_t damped = (uint32_t)(rate * (int32_t)search->damping) * (per_count / DAMPED_PARTS);
    search->vector = upper(search->balance_angle - GAIN * angle - damped);
    search->timer = (off >= -1 && off <= 1 && moved == 0) ? (uint16_t)(search->timer + 1U) : 0U;
    search->last_position = position;
    return search->timer;
}

/* Rotate the vector until the shaft has followed. Two states of balance are invalid: a rotor opposite to the vector,
 * held by friction alone, moves in the other direction, and is caught again from there; with a reversed encoder the
 * shaft runs away once the control is off. */
static void away(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const int32_t counts = AWAY_OVER_MOVE * (int32_t)config->move_counts;
    const int32_t moved = i32_sub_wrap(position, search->origin);
    search->last_position = position;
    if (moved < -counts && search->runaways == 0U) {
        search->runaways++;
        search->lead_angle = 0;
        next(search, STAGE_CATCH);
    } else if (moved > 3 * counts || moved < -counts) {
        search->phase = ROTOR_SEARCH_NO_MOVEMENT; /* a load too large, a heavy shaft, or a reversed encoder */
    } else if (search->timer == 0U && moved < counts && search->lead_angle < (int32_t)config->verify_angle) {
        search->lead_angle = f16_add(search->lead_angle, (frac16_t)config->verify_step);
        search->vector = f16_add_wrap(upper(search->balance_angle), search->lead_angle);
    } else if (++search->timer >= config->hold_ticks) {
        search->phase = (moved >= counts / 2) ? ROTOR_SEARCH_HOLD : ROTOR_SEARCH_NO_MOVEMENT;
        next(search, STAGE_BACK);
    }
}

static void rise(rotor_search_t *search, const rotor_search_config_t *config, frac32_t limit)
{
    search->current = f32_limit((int64_t)search->current + config->current_step, limit);
    if (search->current == limit) {
        next(search, STAGE_CATCH);
    }
}

static void reduce_hold_current(rotor_search_t *search, const rotor_search_config_t *config, frac32_t half)
{
    if (search->current > half) {
        const frac32_t less = search->current - config->current_step;
        search->current = (less > half) ? less : half;
        search->timer = 0;
    } else if (search->timer >= config->hold_ticks) {
        found(search);
    }
}

void rotor_hold_step(rotor_search_t *search, const rotor_search_config_t *config, int32_t position)
{
    const frac32_t limit = f32_from_f16(config->current_limit);
    const int64_t displacement = (int64_t)i32_sub_wrap(position, search->origin) * config->angle_per_count;
    const bool caught = search->stage > (uint16_t)STAGE_CATCH;
    const int64_t displacement_max = caught ? DISPLACEMENT_MAX_CAUGHT : DISPLACEMENT_MAX;
    if (displacement > displacement_max || displacement < -displacement_max) {
        search->phase = ROTOR_SEARCH_NO_MOVEMENT;
        return;
    }
    if (search->low_current_periods >= ROTOR_SEARCH_LOW_CURRENT_MAX) {
        search->phase = ROTOR_SEARCH_LOW_CURRENT;
        return;
    }
    if (search->stage == (uint16_t)STAGE_AWAY) {
        away(search, config, position);
        return;
    }
    const uint16_t ticks_at_origin = balance(search, config, position);
    switch ((rotor_hold_stage_t)search->stage) {
    case STAGE_RISE:
        rise(search, config, limit);
        break;
    case STAGE_CATCH:
        if (!search->brake_released) {
            search->timer = 0;
        } else if (ticks_at_origin >= config->hold_ticks) {
            next(search, STAGE_AWAY);
        }
        break;
    case STAGE_BACK:
        if (ticks_at_origin >= config->rest_ticks) {
            search->lead_angle = search->vector;
            next(search, STAGE_WEAKEN);
        }
        break;
    default:
        reduce_hold_current(search, config, limit / 2);
        break;
    }
}

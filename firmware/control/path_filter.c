#include "control/path_filter.h"

#include "math/divide.h"
#include "math/root.h"

#define SPEED_MAX INT64_C(3000000000) /* its square fits 64 bits */

static path_position_t scaled(path_position_t x, uint16_t omega_n_ts)
{
    return asr64(x * omega_n_ts + INT64_C(0x8000), 16);
}

static path_position_t lower(path_position_t a, path_position_t b) { return (a < b) ? a : b; }

static path_position_t within(path_position_t x, path_position_t max)
{
    return (x > max) ? max : ((x < -max) ? -max : x);
}

path_position_t braking_speed(path_position_t distance, path_position_t acceleration, path_position_t max)
{
    if (distance <= acceleration) {
        return lower(distance, max); /* one step to the target, then standstill */
    }
    /* The speed v is followed by v - a, v - 2 a, ... With v = sqrt(2 a d) - a / 2 the square root falls by a in every
     * tick, and the first step not longer than a is shorter than the speed before it: the last step ends at
     * standstill. */
    const uint32_t twice = (uint32_t)(acceleration * 2);
    const uint32_t half = (uint32_t)(acceleration + 1) >> 1;
    const uint64_t far = (uint64_t)twice * (uint32_t)((uint64_t)distance >> 32);
    if (far >= UINT64_C(1) << 31) {
        return max; /* beyond the range of the root, which covers all speeds */
    }
    const uint64_t square = (far << 32) + (uint64_t)twice * (uint32_t)((uint64_t)distance & UINT32_C(0xFFFFFFFF));
    const uint32_t enough = (uint32_t)max + half;
    if (square >= (uint64_t)enough * enough) {
        return max; /* the usual case, no root needed */
    }
    return (path_position_t)(u64_sqrt(square) - half);
}

/* For a measured speed, which may exceed every limit. */
static path_position_t safe_speed(path_position_t distance, path_position_t acceleration, path_position_t speed)
{
    return braking_speed(distance, acceleration, lower(speed, SPEED_MAX));
}

/* Next speed of a ramp with the remaining distance `distance` >= 0. */
static path_position_t next_speed(path_position_t speed, path_position_t distance, path_position_t step_limit,
                                  path_position_t acceleration)
{
    const path_position_t fastest = speed + acceleration;
    if (fastest <= 0) {
        return fastest; /* still moving away from the target */
    }
    const path_position_t allowed = braking_speed(distance, acceleration, lower(fastest, step_limit));
    const path_position_t slowest = speed - acceleration;
    return (allowed > slowest) ? allowed : slowest;
}

void path_filter_reset(path_filter_t *path, int32_t position, path_position_t step, uint16_t omega_n_ts)
{
    /* In steady motion y(k) - y(k-1) = omega_n Ts m and x(k) = y(k-1) + 2 m; the ramp stored here is x(k-1). */
    path->output = path_counts(position);
    path->filter = i64_over_u16(step * 65536, omega_n_ts);
    path->ramp = path->output + 2 * path->filter - step;
    path->speed = step;
}

void path_filter_start_braking(path_filter_t *path, int32_t target, path_position_t acceleration, uint16_t omega_n_ts)
{
    const int32_t sign = (path->speed < 0) ? -1 : 1;
    const path_position_t speed = sign * path->speed;
    const path_position_t distance = -sign * path_beyond(path->ramp, target);
    if (speed == 0 || safe_speed(distance, acceleration, speed) >= speed - acceleration) {
        return;
    }
    /* In steady deceleration the ramp is slower than the output by 2 a / omega_n, and its lead is smaller by a /
     * omega_n^2. */
    const path_position_t slower = lower(acceleration, scaled(speed, omega_n_ts) >> 1);
    const path_position_t over_omega = i64_over_u16(slower * 65536, omega_n_ts);
    path->speed = sign * (speed - lower(speed, slower + 2 * over_omega));
    path->ramp = path->output + 2 * path->filter - sign * i64_over_u16(over_omega * 65536, omega_n_ts) - path->speed;
}

/* Keep the ramp from passing `target`, and slow enough to stop there, if both held for `before`. */
static void stop_at(path_filter_t *path, int32_t target, path_position_t acceleration, path_filter_t before)
{
    const int32_t sign = (path->ramp < path->output) ? -1 : 1;
    const path_position_t speed = sign * before.speed;
    const path_position_t distance = speed - sign * path_beyond(before.ramp, target);
    /* A ramp that has not yet reversed keeps its lead. */
    if (distance < speed || (speed > 0 && safe_speed(distance, acceleration, speed) < speed - acceleration)) {
        return;
    }
    const path_position_t beyond = path_beyond(path->ramp, target);
    if (sign * beyond > 0) {
        path->ramp -= beyond;
        path->speed = 0;
    } else if (sign * path->speed > 0) {
        path->speed = sign * safe_speed(-sign * beyond, acceleration, sign * path->speed);
    }
}

void path_filter_retune(path_filter_t *path, int32_t target, path_position_t acceleration, uint16_t from_omega_n_ts,
                        uint16_t to_omega_n_ts)
{
    const path_filter_t before = *path;
    const path_position_t step = scaled(path->filter, from_omega_n_ts);
    /* The acceleration of the output in the next tick is (omega_n Ts)^2 times this. */
    const path_position_t excess = path->ramp + path->speed - path->output - 2 * path->filter;
    const path_position_t max = i64_over_u16(i64_over_u16(acceleration << 32, to_omega_n_ts), to_omega_n_ts);
    const path_position_t pull = within(i64_over_u16(excess * from_omega_n_ts, to_omega_n_ts), max);
    const path_position_t next = scaled(scaled(pull, to_omega_n_ts), to_omega_n_ts);
    /* The difference between the speeds of ramp and output determines how the acceleration grows afterwards. */
    const path_position_t even = step + next + i64_over_u16(next * 65536, to_omega_n_ts);
    const path_position_t reach = i64_over_u16(acceleration * 65536, to_omega_n_ts);

    path->filter = i64_over_u16(path->filter * from_omega_n_ts, to_omega_n_ts);
    path->speed = even + within(path->speed - even, reach);
    path->ramp = path->output + 2 * path->filter + pull - path->speed;
    stop_at(path, target, acceleration, before);
}

void path_filter_step(path_filter_t *path, int32_t target, path_position_t step_limit, path_position_t acceleration,
                      uint16_t omega_n_ts)
{
    const path_position_t distance = -path_beyond(path->ramp, target);
    if (distance != 0 || path->speed != 0) {
        path->speed = (distance < 0) ? -next_speed(-path->speed, -distance, step_limit, acceleration)
                                     : next_speed(path->speed, distance, step_limit, acceleration);
        path->ramp += path->speed;
    }
    /* E40, omega_n^2 / (s + omega_n)^2: m = m + omega_n Ts (x - 2 m - y), y = y + omega_n Ts m */
    path->filter += scaled(path->ramp - 2 * path->filter - path->output, omega_n_ts);
    path->output += scaled(path->filter, omega_n_ts);
}

int32_t path_filter_stopping_position(const path_filter_t *path, path_position_t acceleration)
{
    const path_position_t up = path_counts(1) - 1;
    if (path->speed == 0) {
        return path_whole(path->ramp + (up >> 1));
    }
    const path_position_t speed = lower((path->speed < 0) ? -path->speed : path->speed, SPEED_MAX);
    /* (v - a / 2)^2 / (2 a) with a 16-bit divisor, rounded down: the computed distance is never too short. */
    const path_position_t root = speed - (acceleration >> 1);
    uint32_t divisor = (uint32_t)acceleration * 2U;
    uint16_t shift = 0;
    while (divisor > UINT16_MAX) {
        divisor >>= 1;
        shift++;
    }
    const path_position_t distance = asr64(i64_over_u16(root * root, (uint16_t)divisor), shift);
    return (path->speed < 0) ? path_whole(path->ramp - distance) : path_whole(path->ramp + distance + up);
}

#include "plant/quadrature.h"

#include <math.h>

#include "plant/trig.h"

#define NEVER 1e9 /* [s] */

/* Level of an edge's line above it. */
static bool rises(int64_t n) { return ((n & 2) != 0) == ((n & 1) == 0); }

/* Nearly Gaussian with standard deviation 1: three 16-bit uniforms have the variance 3/12; never beyond +-3. */
static double spread(uint64_t bits)
{
    const uint32_t sum = (uint32_t)(bits & 0xFFFFu) + (uint32_t)((bits >> 16) & 0xFFFFu) + (uint32_t)((bits >> 32) & 0xFFFFu);
    return ((double)sum - 1.5 * 65535.0) * (2.0 / 65535.0);
}

static double angle_of(quadrature_t *q, int64_t n)
{
    double shift = rises(n) ? -q->early : q->early;
    if (q->jitter > 0.0) {
        shift += q->jitter * spread(plant_random_bits(&q->random));
    }
    shift = (shift > 0.45) ? 0.45 : (shift < -0.45) ? -0.45 : shift; /* edges keep their order */
    return ((double)n + shift) * q->pitch;
}

static void settle(quadrature_t *q)
{
    q->above = angle_of(q, q->position + 1);
    q->below = angle_of(q, q->position);
}

void quadrature_init(quadrature_t *q, const plant_axis_t *config, uint64_t seed, uint64_t stream)
{
    *q = (quadrature_t){
        .pitch = 2.0 * PLANT_PI / (4.0 * config->encoder_lines),
        .jitter = config->encoder_jitter,
        .early = 2.0 * config->encoder_duty_error,
    };
    plant_random_init(&q->random, seed, stream);
    const double x = config->theta_start / q->pitch;
    q->position = (int64_t)x - ((double)(int64_t)x > x);
    settle(q);
    if (q->above <= config->theta_start) { /* the edges beside the start are not where they should be */
        q->position++;
        settle(q);
        q->below = (q->below < config->theta_start) ? q->below : config->theta_start;
    } else if (q->below > config->theta_start) {
        q->position--;
        settle(q);
        q->above = (q->above > config->theta_start) ? q->above : config->theta_start;
    }
    /* the last edge passed upwards has set its line, the one before the other */
    for (int64_t n = q->position - 1; n <= q->position; n++) {
        q->level[(n & 1) == 0] = rises(n);
    }
}

quadrature_edge_t quadrature_pass(quadrature_t *q, bool upwards)
{
    const int64_t n = upwards ? q->position + 1 : q->position;
    const int line = (n & 1) == 0;
    const bool level = rises(n) == upwards;
    q->position += upwards ? 1 : -1;
    q->level[line] = level;
    settle(q);
    const quadrature_edge_t edge = {line, level, !q->cut[line]};
    return edge;
}

/* Root of way = omega t + accel t^2 / 2 in the form that does not cancel; NEVER if it turns back before. */
static double root_of(double way, double omega, double accel)
{
    const double square = omega * omega + 2.0 * accel * way;
    if (square < 0.0) {
        return NEVER;
    }
    const double sum = omega + ((way < 0.0) ? -sqrt(square) : sqrt(square));
    const double t = (sum != 0.0) ? 2.0 * way / sum : NEVER;
    return (t >= 0.0) ? t : NEVER;
}

double quadrature_time(const quadrature_t *q, double theta, double omega, double accel, double jerk, double reach,
                       bool *upwards)
{
    const double drift = 0.5 * accel * reach;
    const double end = omega + drift;
    const double up = q->above - theta;
    const double down = q->below - theta;
    if (reach * omega < up && reach * end < up && reach * omega > down && reach * end > down) {
        return NEVER;
    }
    *upwards = (omega != 0.0) ? omega > 0.0 : accel > 0.0;
    const double way = *upwards ? up : down;
    if ((way > 0.0) != *upwards) {
        return 0.0; /* an edge that moved across the shaft */
    }
    /* almost at constant speed: t = tau (1 - a tau / 2 + a^2 tau^2 / 2 - ...) - j tau^3 / (6 omega) */
    const double per_omega = (omega != 0.0) ? 1.0 / omega : 0.0;
    const double tau = way * per_omega;
    const double x = accel * per_omega * tau;
    if (x < 0.01 && x > -0.01 && tau > 0.0) {
        return tau * (1.0 - x * (0.5 - x * (0.5 - 0.625 * x)) - (1.0 / 6.0) * jerk * per_omega * tau * tau);
    }
    return root_of(way, omega, accel);
}

#include "plant/quadrature.h"

#include <math.h>

#include "plant/trig.h"

#define NEVER 1e9 /* [s] */
#define MOST_JITTER 0.08 /* [pitches]: edges have to keep their order */
#define MOST_DUTY_ERROR 0.12

/* Level of an edge's line above it. */
static bool rises(int64_t n) { return ((n & 2) != 0) == ((n & 1) == 0); }

/* Nearly Gaussian with standard deviation 1: two 16-bit uniforms have the variance 2/12; never beyond +-2.45. */
static double spread(uint64_t bits)
{
    const int32_t sum = (int32_t)(bits & 0xFFFFu) + (int32_t)((bits >> 16) & 0xFFFFu) - 0xFFFF;
    return (double)sum * (2.449489742783178 / 65535.0);
}

static double angle_of(const quadrature_t *q, int64_t n, uint64_t bits)
{
    const double shift = (rises(n) ? -q->early : q->early) + q->jitter * spread(bits);
    return ((double)n + shift) * q->pitch;
}

static void settle(quadrature_t *q)
{
    const uint64_t bits = plant_random_bits(&q->random);
    q->above = angle_of(q, q->position + 1, bits);
    q->below = angle_of(q, q->position, bits >> 32);
}

static double limit(double error)
{
    return (error > MOST_DUTY_ERROR) ? MOST_DUTY_ERROR : (error < -MOST_DUTY_ERROR) ? -MOST_DUTY_ERROR : error;
}

void quadrature_init(quadrature_t *q, const plant_axis_t *config, uint64_t seed, uint64_t stream)
{
    *q = (quadrature_t){
        .pitch = 2.0 * PLANT_PI / (4.0 * config->encoder_lines),
        .jitter = (config->encoder_jitter < MOST_JITTER) ? config->encoder_jitter : MOST_JITTER,
        .early = 2.0 * limit(config->encoder_duty_error),
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

quadrature_course_t quadrature_course(double theta, double omega, double accel, double jerk, double time)
{
    const double per_omega = (omega != 0.0) ? 1.0 / omega : 0.0;
    return (quadrature_course_t){
        .theta = theta,
        .omega = omega,
        .accel = accel,
        .per_omega = per_omega,
        .bend = accel * per_omega,
        .twist = (1.0 / 6.0) * jerk * per_omega,
        .range = time * (fabs(omega) + time * fabs(accel)),
        .moves = omega != 0.0 || accel != 0.0,
    };
}

double quadrature_time(const quadrature_t *q, const quadrature_course_t *course, bool *upwards)
{
    const bool up = (course->omega != 0.0) ? course->omega > 0.0 : course->accel > 0.0;
    const double way = (up ? q->above : q->below) - course->theta;
    *upwards = up;
    if (fabs(way) > course->range || !course->moves) {
        return NEVER;
    }
    if ((way > 0.0) != up) {
        return 0.0; /* an edge that was drawn on the other side of the shaft */
    }
    /* almost at constant speed: t = tau (1 - a tau / 2 + a^2 tau^2 / 2 - ...) - j tau^3 / (6 omega) */
    const double tau = way * course->per_omega;
    const double x = course->bend * tau;
    if (x < 0.01 && x > -0.01 && tau > 0.0) {
        return tau * (1.0 - x * (0.5 - x * (0.5 - 0.625 * x)) - course->twist * tau * tau);
    }
    return root_of(way, course->omega, course->accel);
}

#include "plant/quadrature.h"

#include <math.h>

#include "plant/trig.h"

#define NEVER 1e9 /* [s] */
#define JITTER_MAX 0.08 /* [pitches]: edges have to keep their order */
#define DUTY_ERROR_MAX 0.12

/* Level of its line above edge n. */
static bool rises(int64_t n) { return ((n & 2) != 0) == ((n & 1) == 0); }

/* Triangular distribution with standard deviation 1: the sum of two 16-bit uniforms has the variance 2/12; limited to +-2.45. */
static double spread(uint64_t bits)
{
    const int32_t sum = (int32_t)(bits & 0xFFFFu) + (int32_t)((bits >> 16) & 0xFFFFu) - 0xFFFF;
    return (double)sum * (2.449489742783178 / 65535.0);
}

static double disc_of(const quadrature_t *q, double theta)
{
    double sine;
    double cosine;
    plant_sincos(theta + q->phase, &sine, &cosine);
    return theta + q->eccentricity * sine;
}

/* Angle of the shaft at which its disc is at `disc` [rad], by Newton's method. */
static double shaft_of(const quadrature_t *q, double disc)
{
    double theta = disc;
    double sine;
    double cosine;
    for (int n = 0; n < 6; n++) {
        plant_sincos(theta + q->phase, &sine, &cosine);
        theta -= (theta + q->eccentricity * sine - disc) / (1.0 + q->eccentricity * cosine);
    }
    return theta;
}

/* Draw the angle of the next edge in a direction [rad]. */
static inline double draw(quadrature_t *q, bool upwards)
{
    const int64_t n = q->position + upwards;
    static const double late[2] = {1.0, -1.0}; /* a table instead of an unpredictable branch */
    const double shift = late[rises(n)] * q->early + q->jitter * spread(plant_random_bits(&q->random));
    const double disc = ((double)(n - q->slipped) + shift) * q->pitch + (upwards ? 0.5 : -0.5) * q->hysteresis;
    return (q->eccentricity > 0.0) ? shaft_of(q, disc) : disc;
}

static double limit(double error)
{
    return (error > DUTY_ERROR_MAX) ? DUTY_ERROR_MAX : (error < -DUTY_ERROR_MAX) ? -DUTY_ERROR_MAX : error;
}

void quadrature_init(quadrature_t *q, const plant_axis_t *config, uint64_t seed, uint64_t stream)
{
    *q = (quadrature_t){
        .pitch = 2.0 * PLANT_PI / (4.0 * config->encoder_lines),
        .jitter = (config->encoder_jitter < JITTER_MAX) ? config->encoder_jitter : JITTER_MAX,
        .early = 2.0 * limit(config->encoder_duty_error),
    };
    q->hysteresis = config->encoder_hysteresis * q->pitch;
    plant_random_init(&q->random, seed, stream);
    q->eccentricity = config->disc_eccentricity;
    q->phase = config->disc_phase;
    const double x = disc_of(q, config->theta_start) / q->pitch;
    q->position = (int64_t)x - ((double)(int64_t)x > x);
    q->upwards = true;
    q->edge[0] = draw(q, false);
    q->edge[1] = draw(q, true);
    /* the last two edges, passed upwards, have set the two lines */
    for (int64_t n = q->position - 1; n <= q->position; n++) {
        q->level[(n & 1) == 0] = rises(n);
    }
}

int32_t quadrature_change(quadrature_t *q, const plant_axis_t *config, double theta)
{
    if (q->eccentricity == config->disc_eccentricity && q->phase == config->disc_phase) {
        return 0;
    }
    const double before = disc_of(q, theta);
    q->eccentricity = config->disc_eccentricity;
    q->phase = config->disc_phase;
    const double edges = (disc_of(q, theta) - before) / q->pitch;
    const int32_t jump = (int32_t)(edges + ((edges < 0.0) ? -0.5 : 0.5));
    q->slipped -= jump;
    q->edge[0] = draw(q, false);
    q->edge[1] = draw(q, true);
    return jump;
}

quadrature_edge_t quadrature_pass(quadrature_t *q)
{
    const int64_t n = q->position + q->upwards;
    const uint8_t line = (n & 1) == 0;
    const bool level = rises(n) == q->upwards;
    q->position += q->upwards ? 1 : -1;
    q->level[line] = level;
    q->edge[!q->upwards] = quadrature_target(q) - (q->upwards ? q->hysteresis : -q->hysteresis);
    q->edge[q->upwards] = draw(q, q->upwards);
    const quadrature_edge_t edge = {line, level != q->flipped[line], !q->cut[line]};
    return edge;
}

void quadrature_slip(quadrature_t *q, bool upwards)
{
    const int64_t n = q->position + upwards;
    q->position += upwards ? 1 : -1;
    q->slipped += upwards ? 1 : -1;
    q->level[(n & 1) == 0] = rises(n) == upwards;
}

quadrature_trajectory_t quadrature_trajectory(quadrature_t *q, double theta, double omega, double accel, double jerk,
                                              double time)
{
    const double drive = (omega != 0.0) ? omega : accel;
    if (drive != 0.0) {
        q->upwards = drive > 0.0;
    }
    const double per_omega = (omega != 0.0) ? 1.0 / omega : 0.0;
    const quadrature_trajectory_t trajectory = {
        .theta = theta,
        .omega = omega,
        .accel = accel,
        .per_omega = per_omega,
        .accel_ratio = accel * per_omega,
        .jerk_ratio = (1.0 / 6.0) * jerk * per_omega,
        .range = time * (fabs(omega) + time * (fabs(accel) + time * fabs(jerk))),
    };
    return trajectory;
}

/* Root of distance = omega t + accel t^2 / 2 in the form without cancellation; NEVER if the shaft reverses before. */
double quadrature_general_time(const quadrature_trajectory_t *trajectory, double distance)
{
    const double omega = trajectory->omega;
    const double drive = (omega != 0.0) ? omega : trajectory->accel;
    if (distance * drive <= 0.0) { /* an edge whose jitter put it behind the shaft, if the shaft moves */
        return (drive != 0.0) ? 0.0 : NEVER;
    }
    const double square = omega * omega + 2.0 * trajectory->accel * distance;
    if (square < 0.0) {
        return NEVER;
    }
    const double sum = omega + ((distance < 0.0) ? -sqrt(square) : sqrt(square));
    const double t = (sum != 0.0) ? 2.0 * distance / sum : NEVER;
    return (t >= 0.0) ? t : NEVER;
}

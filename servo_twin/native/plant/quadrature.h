/* quadrature.h - lines A and B of an incremental encoder at the chip's pins, one per axis (DRM 2.4), for the switching plant.
 *
 * A leads B in positive direction; `lines` periods per turn, four edges per period, every other one on B. Edge n lies
 * between the positions n - 1 and n; upwards A rises at 1, B at 2, A falls at 3, B at 4 (and 0). An ideal edge n is at
 * n pitches; a real one is shifted by
 *   duty error   a line stays high for (1/2 + error) of its period: rising edges come early, falling ones late
 *   jitter       drawn anew each time the shaft arrives from the previous edge; covers mechanics and electronics
 *   hysteresis   of the encoder's comparators: half of it late in either direction, so a reversing shaft passes the edge that
 *                much behind the place where it passed it before, and no edge chatters
 */
#ifndef PLANT_QUADRATURE_H
#define PLANT_QUADRATURE_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "plant/noise.h"

#define QUADRATURE_LINES 2

typedef struct {
    double pitch; /* angle between two edges [rad] */
    double jitter; /* standard deviation of an edge [pitches] */
    double early; /* lead of a rising edge, lag of a falling one, by the duty error [pitches] */
    double hysteresis; /* [rad] */
    double eccentricity, phase; /* disc, as in encoder.h [rad] */
    int64_t position; /* edges passed since angle 0 */
    int64_t slipped; /* edges passed by a slip of the disc */
    bool upwards; /* present or last direction of motion */
    double edge[2]; /* angles of the next edges downwards and upwards [rad] */
    bool level[QUADRATURE_LINES]; /* levels of the encoder outputs */
    bool cut[QUADRATURE_LINES]; /* the line is stuck at the level `stuck` */
    bool stuck[QUADRATURE_LINES];
    bool flipped[QUADRATURE_LINES]; /* inverted by a disturbance */
    plant_random_t random;
} quadrature_t;

/* An edge at the pin. */
typedef struct {
    uint8_t line; /* 0: A, 1: B */
    bool level;
    bool seen; /* false: the line is stuck */
} quadrature_edge_t;

void quadrature_init(quadrature_t *encoder, const plant_axis_t *config, uint64_t seed, uint64_t stream);

/* New eccentricity of the disc, with the shaft at `theta` [rad]. Returns the number of edges by which the disc has jumped; pass them
 * by quadrature_slip. */
int32_t quadrature_change(quadrature_t *encoder, const plant_axis_t *config, double theta);

/* Angle of the next edge in the direction of motion [rad]. */
static inline double quadrature_target(const quadrature_t *encoder) { return encoder->edge[encoder->upwards]; }

/* Pass that edge. */
quadrature_edge_t quadrature_pass(quadrature_t *encoder);

/* Slip of the disc by one edge. */
void quadrature_slip(quadrature_t *encoder, bool upwards);

/* Level at the pin. */
static inline bool quadrature_level(const quadrature_t *encoder, int line)
{
    return encoder->cut[line] ? encoder->stuck[line] : encoder->level[line] != encoder->flipped[line];
}

/* Extrapolated motion of the shaft: theta + omega t + accel t^2 / 2 + jerk t^3 / 6. */
typedef struct {
    double theta, omega, accel; /* at t = 0 [rad], [rad/s], [rad/s^2] */
    double per_omega; /* 1 / omega, 0 from standstill [s/rad] */
    double accel_ratio, jerk_ratio; /* accel / omega [1/s], jerk / (6 omega) [1/s^2] */
    double range; /* upper bound of the motion within the time of interest [rad] */
} quadrature_trajectory_t;

quadrature_trajectory_t quadrature_trajectory(quadrature_t *encoder, double theta, double omega, double accel,
                                              double jerk, double time);

/* General version of quadrature_time for the motion by `distance` [rad]. */
double quadrature_general_time(const quadrature_trajectory_t *trajectory, double distance);

/* Time at which the shaft reaches the next edge [s]; may be in the past; very large if it never does on this trajectory. */
static inline double quadrature_time(const quadrature_t *encoder, const quadrature_trajectory_t *trajectory)
{
    /* nearly constant speed: t = tau (1 - a tau / 2 + a^2 tau^2 / 2 - ...) - j tau^3 / (6 omega) */
    const double distance = quadrature_target(encoder) - trajectory->theta;
    const double tau = distance * trajectory->per_omega;
    const double x = trajectory->accel_ratio * tau;
    const double y =
        trajectory->jerk_ratio * tau * tau; /* jerk due to ripple does not last as long as the motion of a slow shaft */
    if (x < 0.01 && x > -0.01 && y < 0.01 && y > -0.01 && trajectory->per_omega != 0.0) {
        return tau * (1.0 - x * (0.5 - x * (0.5 - 0.625 * x)) - y);
    }
    return quadrature_general_time(trajectory, distance);
}

#endif

/* quadrature.h - lines A and B of an incremental encoder as the chip's pins see them, one per axis (DRM 2.4).
 *
 * A leads B in positive direction; `lines` periods per turn, four edges per period, every other one on B. Edge n lies
 * between the positions n - 1 and n; upwards A rises at 1, B at 2, A falls at 3, B at 4 (and 0). An ideal edge n is at
 * n pitches; a real one is shifted by
 *   duty error   a line stays high for (1/2 + error) of its period: rising edges come early, falling ones late
 *   jitter       drawn anew each time the shaft comes from the edge before, for mechanics and electronics alike
 *   hysteresis   of the encoder's comparators: half of it late in either direction, so that a shaft that turns back finds
 *                the edge that much behind where it passed it, however often it does, and none chatters
 */
#ifndef PLANT_QUADRATURE_H
#define PLANT_QUADRATURE_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "plant/sensors.h"

#define QUADRATURE_LINES 2

typedef struct {
    double pitch;       /* [rad] per edge */
    double jitter;      /* standard deviation of an edge [pitches] */
    double early;       /* of a rising edge, and delay of a falling one [pitches] */
    double hysteresis;  /* [rad] */
    double eccentricity, phase; /* of the disc, as encoder.h has it [rad] */
    int64_t position;   /* edges passed since angle 0 */
    int64_t slipped;    /* of these by the disc alone */
    bool upwards;       /* direction in which the shaft moves, or has moved last */
    double edge[2];     /* angles of the next edges downwards and upwards [rad] */
    bool level[QUADRATURE_LINES];
    bool cut[QUADRATURE_LINES]; /* the line stays at */
    bool stuck[QUADRATURE_LINES];
    bool flipped[QUADRATURE_LINES]; /* by a disturbance, for a moment */
    plant_random_t random;
} quadrature_t;

/* An edge, as the pin sees it. */
typedef struct {
    uint8_t line; /* 0: A, 1: B */
    bool level;
    bool seen; /* false: the line is cut */
} quadrature_edge_t;

void quadrature_init(quadrature_t *encoder, const plant_axis_t *config, uint64_t seed, uint64_t stream);

/* The disc is off its centre by another amount, the shaft at `theta`: returns how many edges it has jumped, which are still to
 * pass by quadrature_slip. */
int32_t quadrature_change(quadrature_t *encoder, const plant_axis_t *config, double theta);

/* Angle of the next edge in the direction of motion [rad]. */
static inline double quadrature_target(const quadrature_t *encoder) { return encoder->edge[encoder->upwards]; }

/* The shaft has reached that edge. */
quadrature_edge_t quadrature_pass(quadrature_t *encoder);

/* The disc turns on the shaft by an edge. */
void quadrature_slip(quadrature_t *encoder, bool upwards);

/* Level at the pin. */
static inline bool quadrature_level(const quadrature_t *encoder, int line)
{
    return encoder->cut[line] ? encoder->stuck[line] : encoder->level[line] != encoder->flipped[line];
}

/* How the shaft moves from some moment on. */
typedef struct {
    double theta, omega, accel;
    double per_omega;    /* 0 for a shaft that starts from rest */
    double bend, twist;  /* accel / omega, jerk / (6 omega) */
    double range;        /* more than the way within the time of interest [rad] */
} quadrature_trajectory_t;

quadrature_trajectory_t quadrature_trajectory(quadrature_t *encoder, double theta, double omega, double accel,
                                              double jerk, double time);

double quadrature_slow_time(const quadrature_trajectory_t *course, double way);

/* Time until the shaft reaches the next edge, which may be in the past or far away; huge if it never does on this course
 * [s]. */
static inline double quadrature_time(const quadrature_t *encoder, const quadrature_trajectory_t *course)
{
    /* almost at constant speed: t = tau (1 - a tau / 2 + a^2 tau^2 / 2 - ...) - j tau^3 / (6 omega) */
    const double way = quadrature_target(encoder) - course->theta;
    const double tau = way * course->per_omega;
    const double x = course->bend * tau;
    const double y = course->twist * tau * tau; /* a slow shaft: the jerk of a ripple does not last so long */
    if (x < 0.01 && x > -0.01 && y < 0.01 && y > -0.01 && course->per_omega != 0.0) {
        return tau * (1.0 - x * (0.5 - x * (0.5 - 0.625 * x)) - y);
    }
    return quadrature_slow_time(course, way);
}

#endif

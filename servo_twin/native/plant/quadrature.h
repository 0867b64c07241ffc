/* quadrature.h - lines A and B of an incremental encoder as the chip's pins see them, one per axis (DRM 2.4).
 *
 * A leads B in positive direction; `lines` periods per turn, four edges per period, every other one on B. Edge n lies
 * between the positions n - 1 and n; upwards A rises at 1, B at 2, A falls at 3, B at 4 (and 0). An ideal edge n is at
 * n pitches; a real one is shifted by
 *   duty error   a line stays high for (1/2 + error) of its period: rising edges come early, falling ones late
 *   jitter       drawn anew each time the shaft passes, for mechanics and electronics alike
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
    int64_t position;   /* edges passed since angle 0 */
    double above, below; /* angles at which the shaft leaves this position [rad] */
    bool level[QUADRATURE_LINES];
    bool cut[QUADRATURE_LINES]; /* the line stays low */
    plant_random_t random;
} quadrature_t;

/* An edge, as the pin sees it. */
typedef struct {
    int line; /* 0: A, 1: B */
    bool level;
    bool seen; /* false: the line is cut */
} quadrature_edge_t;

void quadrature_init(quadrature_t *encoder, const plant_axis_t *config, uint64_t seed, uint64_t stream);

/* The shaft has reached `above` or `below`. */
quadrature_edge_t quadrature_pass(quadrature_t *encoder, bool upwards);

/* Level at the pin. */
static inline bool quadrature_level(const quadrature_t *encoder, int line)
{
    return encoder->level[line] && !encoder->cut[line];
}

/* How the shaft moves from some moment on. */
typedef struct {
    double theta, omega, accel;
    double per_omega;    /* 0 for a shaft that starts from rest */
    double bend, twist;  /* accel / omega, jerk / (6 omega) */
    double range;        /* more than it covers within the time of interest [rad] */
    bool moves;
} quadrature_course_t;

quadrature_course_t quadrature_course(double theta, double omega, double accel, double jerk, double time);

/* Time until the shaft leaves the position in the direction in which it begins to move; huge if that takes longer than
 * the time of interest [s]. `upwards` tells on which side. */
double quadrature_time(const quadrature_t *encoder, const quadrature_course_t *course, bool *upwards);

#endif

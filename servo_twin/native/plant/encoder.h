/* encoder.h - incremental encoder with the quad timer that decodes it (DRM 2.4, F10-F19), one per axis, for the averaged plant.
 *
 * A leads B in positive direction; there are `lines` periods per turn and four edges per period, every other one on B.
 * The counter starts at 0 at any rotor angle: the firmware does not know the absolute angle.
 *
 *   TMRx0  counts every edge; reaching COMP1 = period - 1 upwards or COMP2 = 1 - period downwards is a compare match; the
 *          *next* count in the same direction loads 0.
 *   OFLAG  set by the match, cleared by the next B edge. Its rising edge clocks TMRx2, so a shaft that reverses at the
 *          compare value gives an index pulse without a full turn.
 *   TMRx0/1 capture count and time on a B edge; the flag IEF blocks further captures until software clears it.
 *   TMRx3  time since the last captured edge; after an overflow of 16 bits it stays invalid until the next captured edge.
 */
#ifndef PLANT_ENCODER_H
#define PLANT_ENCODER_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"

typedef enum { PLANT_LINE_A, PLANT_LINE_B, PLANT_ENCODER_LINES } plant_line_t;

/* An eccentric disc is at theta + a sin(theta + phase), a < 1, so the edges keep their order. */
typedef struct {
    double edges_per_rad; /* negative: A and B are swapped [1/rad] */
    bool connected[PLANT_ENCODER_LINES]; /* lines that switch */
    bool stuck[PLANT_ENCODER_LINES]; /* level of a line that does not switch */
    bool eccentric; /* the disc is eccentric */
    int64_t edge; /* edges passed since angle 0 */
    int64_t slipped; /* edges passed by a slip of the disc */
    uint16_t period; /* counts from one reload of TMRx0 to the next, at most 32768 */
    uint16_t count; /* TMRx0 */
    uint16_t index; /* TMRx2 */
    bool oflag; /* output of TMRx0 */
    bool armed; /* IEF is clear: the next B edge is captured */
    bool captured; /* an edge has not been read yet */
    uint16_t captured_count; /* at the captured edge [counts] */
    uint64_t captured_ns; /* time of the captured edge [ns] */
    double eccentricity, phase; /* disc: a [rad], phase [rad] */
} plant_encoder_t;

/* Motion of the shaft over one step, with a speed linear in time. */
typedef struct {
    double theta_0, theta_1; /* [rad] */
    double omega_0, omega_1; /* [rad/s] */
    double start_ns; /* since the reference time of the step [ns] */
    double duration_ns; /* [ns] */
} plant_movement_t;

void plant_encoder_init(plant_encoder_t *encoder, const plant_axis_t *config);

/* New eccentricity of the disc; its edges pass at the next motion. */
void plant_encoder_change(plant_encoder_t *encoder, const plant_axis_t *config);

/* Angle of the disc with the shaft at `theta` [rad]: of an eccentric one, of any one. */
double plant_encoder_eccentric(const plant_encoder_t *encoder, double theta);
static inline double plant_encoder_disc(const plant_encoder_t *encoder, double theta)
{
    return encoder->eccentric ? plant_encoder_eccentric(encoder, theta) : theta;
}

/* True if the shaft at `theta` has passed an edge that is not counted yet, or `theta` is not a number. */
static inline bool plant_encoder_leaves(const plant_encoder_t *encoder, double theta)
{
    const double x =
        plant_encoder_disc(encoder, theta) * encoder->edges_per_rad - (double)(encoder->edge - encoder->slipped);
    return !(x >= 0.0 && x < 1.0);
}

/* Follow the shaft; `reference_ns` is the simulated time to which start_ns refers. */
void plant_encoder_move(plant_encoder_t *encoder, const plant_movement_t *movement, uint64_t reference_ns);

/* plant_encoder_move for an encoder that is not armed: no edge is captured, so only the final angle is needed. */
void plant_encoder_count(plant_encoder_t *encoder, double theta);

/* Connect or disconnect both lines. A disconnected encoder does not count; edges missed are lost. */
void plant_encoder_connect(plant_encoder_t *encoder, bool connected, double theta);

/* Stick one line at a level, or release it. The decoder then counts the edges of the other line alternately up and down. */
void plant_encoder_stick(plant_encoder_t *encoder, plant_line_t line, bool stuck, bool level);

/* Slip of the disc on the shaft by a number of edges, which pass at the next step. */
void plant_encoder_slip(plant_encoder_t *encoder, int edges);

/* Short pulse on a line: one count forwards and back, and on B an edge to capture. */
void plant_encoder_glitch(plant_encoder_t *encoder, plant_line_t line, uint64_t now_ns);

/* Swap A and B: the direction of counting changes. */
void plant_encoder_reverse(plant_encoder_t *encoder, double theta);

/* Reset of the timers. */
void plant_encoder_restart(plant_encoder_t *encoder);

/* Start TMRx0 at 0 with this period. */
void plant_encoder_start(plant_encoder_t *encoder, uint16_t period);

/* Arm the capture of the next edge on B. */
void plant_encoder_arm(plant_encoder_t *encoder);

/* Read a captured edge: count, and time stamp (board_clock.h). True once per edge. */
bool plant_encoder_take(plant_encoder_t *encoder, uint16_t *count, uint16_t *time);

/* TMRx3 in periods of the time stamp, saturated at 0x10000. */
uint32_t plant_encoder_age(const plant_encoder_t *encoder, uint64_t now_ns);

#endif

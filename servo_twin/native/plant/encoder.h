/* encoder.h - incremental encoder and the quad timer that listens to it (DRM 2.4, F10-F19), one per axis.
 *
 * A leads B in positive direction; there are `lines` periods per turn and four edges per period, every other one on B.
 * Which absolute angle the first edge has is unknown to the firmware: the counter begins at 0 wherever the rotor is.
 *
 *   TMRx0  counts every edge; a count that reaches COMP1 = 3999 upwards or COMP2 = -3999 downwards is a compare match,
 *          and the *next* count in the same direction loads 0.
 *   OFLAG  set by the match, cleared by the next B edge. Its rising edge clocks TMRx2. So a shaft that touches the compare
 *          value and turns back makes an index pulse without a turn.
 *   TMRx0/1 capture count and time on a B edge; the flag IEF blocks further captures until software clears it.
 *   TMRx3  time since the last latched edge; too long for 16 bits stays so until the next latched edge.
 */
#ifndef PLANT_ENCODER_H
#define PLANT_ENCODER_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"

#define PLANT_ENCODER_TICK_NS UINT64_C(1280) /* bus clock / 128 at 100 MHz: 781.25 kHz */

typedef enum { PLANT_LINE_A, PLANT_LINE_B, PLANT_ENCODER_LINES } plant_line_t;

/* The disc may be off the shaft's centre, which then turns by theta + a sin(theta + phase), a < 1: edges keep their order. */
typedef struct {
    double edges_per_rad; /* negative: A and B are swapped */
    bool alive[PLANT_ENCODER_LINES]; /* lines that still switch */
    bool stuck[PLANT_ENCODER_LINES]; /* level of one that does not */
    bool eccentric; /* the disc */
    int64_t edge;        /* edges passed since angle 0 */
    int64_t slipped;     /* of these by the disc alone */
    uint16_t count;      /* TMRx0 */
    uint16_t index;      /* TMRx2 */
    bool oflag;
    bool armed;          /* IEF is clear: the next B edge is latched */
    bool latched;        /* an edge waits for the interrupt's software */
    uint16_t captured_count;
    uint64_t captured_ns;
    double eccentricity, phase; /* of the disc: a, phase [rad] */
} plant_encoder_t;

/* Movement of the shaft over one step; the speed in between is taken as linear. */
typedef struct {
    double theta_0, theta_1; /* [rad] */
    double omega_0, omega_1; /* [rad/s] */
    double start_ns;         /* since the step's own reference time */
    double duration_ns;
} plant_movement_t;

void plant_encoder_init(plant_encoder_t *encoder, const plant_axis_t *config);

/* The disc is off its centre by another amount; its edges pass with the next movement. */
void plant_encoder_change(plant_encoder_t *encoder, const plant_axis_t *config);

/* Where the disc is with the shaft at `theta`. Any disc, and one that may be centred. */
double plant_encoder_eccentric(const plant_encoder_t *encoder, double theta);
static inline double plant_encoder_disc(const plant_encoder_t *encoder, double theta)
{
    return encoder->eccentric ? plant_encoder_eccentric(encoder, theta) : theta;
}

/* True if the shaft at `theta` is past an edge that has not been counted yet. */
static inline bool plant_encoder_leaves(const plant_encoder_t *encoder, double theta)
{
    const double x =
        plant_encoder_disc(encoder, theta) * encoder->edges_per_rad - (double)(encoder->edge - encoder->slipped);
    return x < 0.0 || x >= 1.0;
}

/* Follow the shaft; `reference_ns` is the simulated time that start_ns refers to. */
void plant_encoder_move(plant_encoder_t *encoder, const plant_movement_t *movement, uint64_t reference_ns);

/* The same for an encoder that is not armed: no edge is captured, and only where the shaft ends matters. */
void plant_encoder_count(plant_encoder_t *encoder, double theta);

/* Lines alive or dead; a dead encoder counts nothing, and what it missed is lost. */
void plant_encoder_connect(plant_encoder_t *encoder, bool connected, double theta);

/* One line stays at a level, or follows the shaft again: of the edges on the other, which one comes last is all that the
 * decoder can tell. */
void plant_encoder_stick(plant_encoder_t *encoder, plant_line_t line, bool stuck, bool level);

/* The disc turns on the shaft: so many edges pass with the next movement, or without one. */
void plant_encoder_slip(plant_encoder_t *encoder, int edges);

/* A short pulse on a line: one count there and back, and on B an edge to capture. */
void plant_encoder_glitch(plant_encoder_t *encoder, plant_line_t line, uint64_t now_ns);

/* A and B swapped: from here on it counts the other way. */
void plant_encoder_reverse(plant_encoder_t *encoder, double theta);

/* The timers after a reset of the chip. */
void plant_encoder_restart(plant_encoder_t *encoder);

void plant_encoder_arm(plant_encoder_t *encoder);

/* True once per latched edge. */
bool plant_encoder_take(plant_encoder_t *encoder, uint16_t *count, uint16_t *time);

/* TMRx3 in ticks, saturated at 0x10000. */
uint32_t plant_encoder_age(const plant_encoder_t *encoder, uint64_t now_ns);

#endif

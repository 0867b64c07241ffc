#include "plant/encoder.h"

#include <math.h>
#include <stddef.h>

#include "board_clock.h"
#include "plant/inline.h"
#include "plant/trig.h"

#define AGE_OVERFLOW UINT32_C(0x10000)

static int64_t edges_at(const plant_encoder_t *encoder, double theta)
{
    const double x = plant_encoder_disc(encoder, theta) * encoder->edges_per_rad;
    const int64_t whole = (int64_t)x;
    return whole - ((double)whole > x) + encoder->slipped; /* round down */
}

void plant_encoder_change(plant_encoder_t *encoder, const plant_axis_t *config)
{
    encoder->eccentric = config->disc_eccentricity > 0.0;
    encoder->eccentricity = config->disc_eccentricity;
    encoder->phase = config->disc_phase;
}

void plant_encoder_init(plant_encoder_t *encoder, const plant_axis_t *config)
{
    *encoder = (plant_encoder_t){
        .edges_per_rad = config->encoder_lines * (4.0 / (2.0 * PLANT_PI)),
        .connected = {true, true},
    };
    plant_encoder_change(encoder, config);
    encoder->edge = edges_at(encoder, config->theta_start);
}

/* Time from the beginning of the motion to the angle of an edge [ns]: root of
 * theta_0 + omega_0 t + (omega_1 - omega_0) t^2 / (2 T) = theta in the form without cancellation. */
static double time_to(const plant_movement_t *m, double theta)
{
    const double seconds = m->duration_ns * 1e-9;
    const double distance = theta - m->theta_0;
    const double slope = (m->omega_1 - m->omega_0) / seconds;
    const double square = m->omega_0 * m->omega_0 + 2.0 * slope * distance;
    const double root = (square > 0.0) ? sqrt(square) : 0.0;
    const double sum = m->omega_0 + ((distance < 0.0) ? -root : root);
    const double t = (sum != 0.0) ? 2.0 * distance / sum * 1e9 : m->duration_ns;
    return (t < 0.0) ? 0.0 : (t > m->duration_ns) ? m->duration_ns : t;
}

/* Compare value in a direction. */
static int16_t compare_of(const plant_encoder_t *encoder, bool upwards)
{
    const int32_t last = (int32_t)encoder->period - 1;
    return (int16_t)(upwards ? last : -last);
}

static void count_one(plant_encoder_t *encoder, bool upwards)
{
    const uint16_t compare = (uint16_t)compare_of(encoder, upwards);
    if (encoder->count == compare) {
        encoder->count = 0;
    } else {
        encoder->count = (uint16_t)(encoder->count + (upwards ? 1u : 0xFFFFu));
    }
    if (encoder->count == compare) {
        if (!encoder->oflag) {
            encoder->index++;
        }
        encoder->oflag = true;
    }
}

/* Direction that the decoder finds for an edge. Upwards A rises at 1, B at 2, A falls at 3, B at 4 (and 0). With the other line
 * stuck low, A rising or B falling is decoded as upwards, A falling or B rising as downwards; with it stuck high, vice versa. */
static bool decoded_upwards(const plant_encoder_t *encoder, plant_line_t line, int64_t number, bool upwards)
{
    if (encoder->connected[PLANT_LINE_A] && encoder->connected[PLANT_LINE_B]) {
        return upwards;
    }
    const bool rises_upwards = ((number & 2) != 0) == (line == PLANT_LINE_B);
    const bool rises = rises_upwards == upwards;
    return (rises == (line == PLANT_LINE_A)) != encoder->stuck[1 - (int)line];
}

static void latch_at(plant_encoder_t *encoder, uint64_t time_ns)
{
    encoder->captured_ns = time_ns;
    encoder->captured_count = encoder->count;
    encoder->armed = false;
    encoder->captured = true;
}

PLANT_COLD double plant_encoder_eccentric(const plant_encoder_t *encoder, double theta)
{
    double sine;
    double cosine;
    plant_sincos(theta + encoder->phase, &sine, &cosine);
    return theta + encoder->eccentricity * sine;
}

/* Motion of an eccentric disc. */
static PLANT_COLD plant_movement_t motion_of_disc(const plant_encoder_t *encoder, const plant_movement_t *movement)
{
    plant_movement_t disc = *movement;
    double sine;
    double cosine[2];
    plant_sincos(movement->theta_0 + encoder->phase, &sine, &cosine[0]);
    plant_sincos(movement->theta_1 + encoder->phase, &sine, &cosine[1]);
    disc.theta_0 = plant_encoder_eccentric(encoder, movement->theta_0);
    disc.theta_1 = plant_encoder_eccentric(encoder, movement->theta_1);
    disc.omega_0 += encoder->eccentricity * cosine[0] * movement->omega_0;
    disc.omega_1 += encoder->eccentricity * cosine[1] * movement->omega_1;
    return disc;
}

static void latch(plant_encoder_t *encoder, const plant_movement_t *movement, uint64_t reference_ns, int64_t number)
{
    const double theta = (double)(number - encoder->slipped) / encoder->edges_per_rad;
    double t;
    if (encoder->eccentric) {
        const plant_movement_t disc = motion_of_disc(encoder, movement);
        t = movement->start_ns + time_to(&disc, theta);
    } else {
        t = movement->start_ns + time_to(movement, theta);
    }
    latch_at(encoder, reference_ns + (uint64_t)t);
}

/* Edge by edge. */
static void move_edge_by_edge(plant_encoder_t *encoder, const plant_movement_t *movement, uint64_t reference_ns,
                              int64_t target)
{
    while (encoder->edge != target) {
        const bool upwards = target > encoder->edge;
        /* edge number n lies between the positions n - 1 and n */
        const int64_t number = upwards ? encoder->edge + 1 : encoder->edge;
        const bool b_edge = (number & 1) == 0;
        encoder->edge += upwards ? 1 : -1;
        const plant_line_t line = b_edge ? PLANT_LINE_B : PLANT_LINE_A;
        if (!encoder->connected[line]) {
            continue;
        }
        if (b_edge) {
            encoder->oflag = false;
        }
        count_one(encoder, decoded_upwards(encoder, line, number, upwards));
        if (b_edge && encoder->armed) {
            latch(encoder, movement, reference_ns, number);
        }
    }
}

/* All edges at once, with both lines connected and no compare value among the counts. */
static inline void move_at_once(plant_encoder_t *encoder, const plant_movement_t *movement, uint64_t reference_ns,
                                int64_t edges)
{
    const bool upwards = edges > 0;
    const uint16_t begin = encoder->count;
    const bool first_is_b = ((encoder->edge & 1) != 0) == upwards;
    const bool passes_b = first_is_b || edges > 1 || edges < -1;
    encoder->oflag = encoder->oflag && !passes_b;
    if (encoder->armed && passes_b) {
        const int to_b = first_is_b ? 1 : 2; /* edges up to the first on B */
        const int64_t number = upwards ? encoder->edge + to_b : encoder->edge + 1 - to_b;
        encoder->count = (uint16_t)(begin + (upwards ? to_b : -to_b));
        latch(encoder, movement, reference_ns, number);
    }
    encoder->count = (uint16_t)(begin + (uint16_t)edges);
    encoder->edge += edges;
}

static PLANT_NOINLINE void move_to(plant_encoder_t *encoder, int64_t target, const plant_movement_t *movement,
                                   uint64_t reference_ns)
{
    const int64_t edges = target - encoder->edge;
    if (edges == 0) {
        return;
    }
    const int64_t count = (int16_t)encoder->count + edges;
    const int16_t compare = compare_of(encoder, edges > 0);
    const bool within = (edges > 0) ? count < compare : count > compare;
    if (within && encoder->connected[PLANT_LINE_A] && encoder->connected[PLANT_LINE_B]) {
        move_at_once(encoder, movement, reference_ns, edges);
    } else {
        move_edge_by_edge(encoder, movement, reference_ns, target);
    }
}

void plant_encoder_move(plant_encoder_t *encoder, const plant_movement_t *movement, uint64_t reference_ns)
{
    move_to(encoder, edges_at(encoder, movement->theta_1), movement, reference_ns);
}

void plant_encoder_count(plant_encoder_t *encoder, double theta)
{
    move_to(encoder, edges_at(encoder, theta), NULL, 0);
}

void plant_encoder_connect(plant_encoder_t *encoder, bool connected, double theta)
{
    encoder->connected[PLANT_LINE_A] = connected;
    encoder->connected[PLANT_LINE_B] = connected;
    encoder->stuck[PLANT_LINE_A] = false;
    encoder->stuck[PLANT_LINE_B] = false;
    encoder->edge = edges_at(encoder, theta);
}

void plant_encoder_stick(plant_encoder_t *encoder, plant_line_t line, bool stuck, bool level)
{
    encoder->connected[line] = !stuck;
    encoder->stuck[line] = level;
}

void plant_encoder_slip(plant_encoder_t *encoder, int edges) { encoder->slipped += edges; }

void plant_encoder_glitch(plant_encoder_t *encoder, plant_line_t line, uint64_t now_ns)
{
    if (!encoder->connected[line]) {
        return;
    }
    /* the next edge upwards is on B at odd positions, so a change of that line is decoded as upwards */
    const bool upwards = ((encoder->edge & 1) != 0) == (line == PLANT_LINE_B);
    const bool b_edge = line == PLANT_LINE_B;
    encoder->oflag = encoder->oflag && !b_edge;
    count_one(encoder, upwards);
    if (b_edge && encoder->armed) {
        latch_at(encoder, now_ns);
    }
    encoder->oflag = encoder->oflag && !b_edge;
    count_one(encoder, !upwards);
}

void plant_encoder_reverse(plant_encoder_t *encoder, double theta)
{
    encoder->edges_per_rad = -encoder->edges_per_rad;
    encoder->edge = edges_at(encoder, theta);
}

void plant_encoder_restart(plant_encoder_t *encoder)
{
    encoder->count = 0;
    encoder->index = 0;
    encoder->oflag = false;
    encoder->armed = false;
    encoder->captured = false;
}

void plant_encoder_start(plant_encoder_t *encoder, uint16_t period)
{
    encoder->period = period;
    encoder->count = 0;
}

void plant_encoder_arm(plant_encoder_t *encoder)
{
    encoder->armed = true;
    encoder->captured = false;
}

bool plant_encoder_take(plant_encoder_t *encoder, uint16_t *count, uint16_t *time)
{
    if (!encoder->captured) {
        return false;
    }
    *count = encoder->captured_count;
    *time = (uint16_t)board_stamp(encoder->captured_ns);
    encoder->captured = false;
    return true;
}

uint32_t plant_encoder_age(const plant_encoder_t *encoder, uint64_t now_ns)
{
    const uint64_t age = board_stamp(now_ns) - board_stamp(encoder->captured_ns);
    return (age < AGE_OVERFLOW) ? (uint32_t)age : AGE_OVERFLOW;
}

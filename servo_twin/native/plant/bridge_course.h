/* bridge_course.h - the currents of a segment on their way to its end; for bridge_frame.c alone.
 *
 * Where a phase's current comes to zero its leg goes to another voltage: with a gate on, the drop changes its sign, and the
 * current goes through if that lets it; or else the leg floats. Either way the segment goes on as another parabola. What
 * that adds to charge, impulse, losses and amplifiers follows from the volts and the moments; only the square of the current
 * goes by a straight line to the end. Where it can't go on so, the segment ends.
 */
#ifndef PLANT_BRIDGE_COURSE_H
#define PLANT_BRIDGE_COURSE_H

#include "plant/bridge_lanes.h"

#define STRAIGHT 0.05 /* bend of a current on its way through zero, of its fall, that a series is good for */
#define PASSES 4

/* How a segment begins. */
typedef struct {
    lanes_t i, di, ddi; /* [A], [A/s], [A/s^2] */
    lanes_t v;          /* of the legs: alpha, beta, their mean, nothing [V] */
} segment_t;

typedef struct {
    int phase;
    double at;           /* [s] */
    double volts, slope; /* by which the leg is higher from then on [V], [V/s] */
} pass_t;

typedef struct {
    double from;                 /* where the present parabola begins, after the last pass [s] */
    lanes_t i, di, ddi;          /* there */
    double end;                  /* of the segment [s] */
    lanes_t last;                /* current there */
    unsigned positive, negative; /* signs of the currents */
    int floating;                /* leg that has none, -1: none is known to */
    int passes;
    pass_t pass[PASSES];
} course_t;

PLANT_INLINE segment_t segment_of(const bridge_t *b)
{
    const bridge_frame_t *f = &b->frame;
    return (segment_t){lanes_of(f->i), lanes_of(f->di), lanes_of(f->ddi), lanes_of(f->v)};
}

PLANT_INLINE void keep_segment(bridge_t *b, const segment_t *s)
{
    bridge_frame_t *f = &b->frame;
    put_lanes(f->i, s->i);
    put_lanes(f->di, s->di);
    put_lanes(f->ddi, s->ddi);
    put_lanes(f->v, s->v);
    put(&b->di, vector(s->di));
}

/* ---- legs: a frame has none that touches another one, or bus minus ---------------------------------------------------- */

/* What conducts. */
PLANT_INLINE void find_way(bridge_t *b)
{
    const unsigned upper = from_upper(b);
    b->paths = (bridge_paths_t){.upper = upper, .raised = b->negative, .lower = BRIDGE_LEGS & ~upper};
    put(&b->a, vector(lanes_of(legs_at[upper])));
}

/* ---- the way ---------------------------------------------------------------------------------------------------------- */

PLANT_INLINE lanes_t course_at(const course_t *c, double t)
{
    const double h = t - c->from;
    return c->i + all(h) * (c->di + all(0.5 * h) * c->ddi);
}

PLANT_INLINE lanes_t slope_at(const course_t *c, double t) { return c->di + all(t - c->from) * c->ddi; }

PLANT_INLINE void start_course(course_t *c, const bridge_t *b, const segment_t *s, double end)
{
    c->from = 0.0;
    c->i = s->i;
    c->di = s->di;
    c->ddi = s->ddi;
    c->end = end;
    c->last = course_at(c, end);
    c->positive = b->positive;
    c->negative = b->negative;
    c->floating = b->floating;
    c->passes = 0;
}

/* Where parabolas that begin with slopes d0 go through zero within h, by phase: where the chord does, and the bend as a
 * series. Returns the phases for which that is good enough. */
PLANT_INLINE unsigned chord_roots(lanes_t f0, lanes_t f1, lanes_t d0, double h, lanes_t *root)
{
    const lanes_t fall = f0 - f1;
    const lanes_t per_fall = all(1.0) / fall;
    const lanes_t part = f0 * per_fall;
    const lanes_t left = all(1.0) - part;
    const lanes_t bent = (all(-h) * d0 - fall) * per_fall;
    *root = all(h) * (part - bent * part * left * (all(1.0) - bent * (left - part)));
    return lanes_where((part > 0.0) & (left > 0.0) & (bent < STRAIGHT) & (bent > -STRAIGHT));
}

/* The same for one that bends much. */
static inline double bent_root(double f0, double f1, double d0, double h)
{
    const double way = (f1 < 0.0) ? 1.0 : -1.0;
    return root_of(f0 * way, d0 * way, f1 * way, h);
}

/* Of the phases `beyond` zero at the end: which was the first to be there, and when. In branches, that a processor may go
 * on before it knows the answer. */
PLANT_INLINE int first_zero(const course_t *c, unsigned beyond, double *t)
{
    const double h = c->end - c->from;
    lanes_t roots;
    const unsigned straight = chord_roots(c->i, c->last, c->di, h, &roots);
    double soonest = h;
    int first = -1;
    for (int k = 0; k < 3; k++) {
        if ((beyond & BRIDGE_LEG(k)) != 0u) {
            const int lane = BRIDGE_LANE(k);
            const double zero =
                (straight & BRIDGE_LEG(k)) != 0u ? roots[lane] : bent_root(c->i[lane], c->last[lane], c->di[lane], h);
            if (first < 0 || zero < soonest) {
                first = k;
                soonest = zero;
            }
        }
    }
    *t = c->from + soonest;
    return first;
}

/* Phase k is at zero at t. True if the course is another one from there on; false, with all as it was, if the segment has to
 * end there. */
PLANT_INLINE bool pass_zero(course_t *c, const bridge_t *b, int k, double t, double u)
{
    if (c->floating >= 0 || c->passes == PASSES) {
        return false;
    }
    const bridge_frame_t *f = &b->frame;
    const unsigned leg = BRIDGE_LEG(k);
    const bool falls = (c->positive & leg) != 0u;
    const bool open = (b->gates & BRIDGE_BOTH(leg)) == 0u;
    const double most = 2.0 * b->v_drop + (open ? u : 0.0); /* from one end of the leg's interval to the other */
    const double h = t - c->from;
    const double rest = c->end - t;
    const lanes_t along = lanes_of(f->along[k]);
    const double needed =
        -1.5 * f->per_l[k] * phase_of(c->di + all(h) * c->ddi, k); /* for the current to stay at zero */
    const bool through = falls ? !(needed < most) : !(needed > -most);
    const double volts = !through ? needed : falls ? most : -most;
    const lanes_t more = all((2.0 / 3.0) * volts) * along;
    lanes_t turn = product(f->drift, more);
    double slope = 0.0;
    if (through) {
        if (open) {
            return false;
        }
        c->positive ^= leg;
        c->negative ^= leg;
    } else {
        slope = -1.5 * f->per_l[k] * phase_of(c->ddi + turn, k);
        const double last = needed + slope * rest;
        if (falls ? !(needed > 0.0 && last > 0.0 && last < most) : !(needed < 0.0 && last < 0.0 && last > -most)) {
            return false;
        }
        turn += all((2.0 / 3.0) * slope) * along;
        c->positive &= ~leg;
        c->negative &= ~leg;
        c->floating = k;
    }
    c->i = without(course_at(c, t), k);
    c->di += all(h) * c->ddi + more;
    c->ddi += turn;
    c->last += all(rest) * (more + all(0.5 * rest) * turn);
    c->from = t;
    c->pass[c->passes++] = (pass_t){k, t, volts, slope};
    return true;
}

/* To the end of the segment, or to where that has to be: returns the leg whose current is at zero then, or -1. */
PLANT_INLINE int follow_course(course_t *c, const bridge_t *b, double u)
{
    for (;;) {
        const unsigned beyond = beyond_zero(c->last, c->positive, c->negative);
        if (beyond == 0u) {
            return -1;
        }
        double t;
        const int k = first_zero(c, beyond, &t);
        if (!pass_zero(c, b, k, t, u)) {
            c->end = t;
            return k;
        }
    }
}

/* What the passes add to charge, impulse of the voltage and losses [A s], [V s], [J]; and what the amplifiers have not seen
 * of the slope at the end [A/s]. */
PLANT_INLINE void account_passes(const course_t *c, const bridge_t *b, pair_t *charge, lanes_t *impulse, lanes_t *slope,
                                 double *lost)
{
    double last[BRIDGE_LANES];
    put_lanes(last, c->last);
    for (const pass_t *pass = c->pass; pass < c->pass + c->passes; pass++) {
        const lanes_t along = lanes_of(b->frame.along[pass->phase]);
        const double h = c->end - pass->at;
        const double volt_seconds = h * (pass->volts + 0.5 * h * pass->slope);
        const double volt_seconds_2 = h * h * (pass->volts + THIRD * h * pass->slope); /* twice their integral */
        *charge += both(THIRD * volt_seconds_2) * vector(along);
        *impulse += all(volt_seconds) * lanes_of(legs_at[BRIDGE_LEG(pass->phase)]);
        *lost -= 0.5 * volt_seconds * last[BRIDGE_LANE(pass->phase)];
        *slope -= all((2.0 / 3.0) * pass->volts * decay(b, h)) * along;
    }
}

#endif

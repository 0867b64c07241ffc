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

/* Kept in registers, which an array would forbid: the passes are elsewhere. */
typedef struct {
    double from;                 /* where the present parabola begins, after the last pass [s] */
    lanes_t i, di, ddi;          /* there */
    double end;                  /* of the segment [s] */
    lanes_t last;                /* current there */
    unsigned positive, negative; /* signs of the currents */
    int floating;                /* leg that has none, -1: none is known to */
    int passes;
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

/* h seconds after the present parabola's beginning. */
PLANT_INLINE lanes_t course_after(const course_t *c, double h)
{
    return (c->i + all(h) * c->di) + all(h * h) * (all(0.5) * c->ddi);
}

PLANT_INLINE lanes_t course_at(const course_t *c, double t) { return course_after(c, t - c->from); }

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
    const lanes_t per_fall = all(1.0) / (f0 - f1);
    const lanes_t part = f0 * per_fall;
    const lanes_t left = -f1 * per_fall;
    const lanes_t bent = (all(-h) * d0) * per_fall - all(1.0);
    const lanes_t skew = all(1.0) + bent * ((f0 + f1) * per_fall);
    *root = all(h) * part - (all(h) * left) * ((bent * part) * skew);
    return lanes_where((part > 0.0) & (left > 0.0) & (bent < STRAIGHT) & (bent > -STRAIGHT));
}

/* Of `legs`, which bend much; the other roots stay. */
static PLANT_RARE void bent_roots(const double f0[BRIDGE_LANES], const double f1[BRIDGE_LANES],
                                  const double d0[BRIDGE_LANES], double h, unsigned legs, double root[BRIDGE_LANES])
{
    for (int k = 0; k < 3; k++) {
        if ((legs & BRIDGE_LEG(k)) != 0u) {
            const int lane = BRIDGE_LANE(k);
            const double way = (f1[lane] < 0.0) ? 1.0 : -1.0;
            root[lane] = root_of(f0[lane] * way, d0[lane] * way, f1[lane] * way, h);
        }
    }
}

PLANT_INLINE lanes_t roots_of(const course_t *c, unsigned beyond, double h)
{
    lanes_t roots;
    const unsigned bent = beyond & ~chord_roots(c->i, c->last, c->di, h, &roots);
    if (bent != 0u) {
        double f0[BRIDGE_LANES], f1[BRIDGE_LANES], d0[BRIDGE_LANES], root[BRIDGE_LANES];
        put_lanes(f0, c->i);
        put_lanes(f1, c->last);
        put_lanes(d0, c->di);
        put_lanes(root, roots);
        bent_roots(f0, f1, d0, h, bent, root);
        roots = lanes_of(root);
    }
    return roots;
}

/* Of the phases `beyond` zero at the end: which was the first to be there, and *h seconds after the parabola's beginning. In
 * branches, that a processor may go on before it knows the answer. */
PLANT_INLINE int first_zero(const course_t *c, unsigned beyond, double *h)
{
    const lanes_t roots = roots_of(c, beyond, c->end - c->from);
    int first = 0;
    *h = (beyond & LEG_A) != 0u ? roots[BRIDGE_LANE(0)] : INFINITY;
    for (int k = 1; k < 3; k++) {
        if ((beyond & BRIDGE_LEG(k)) != 0u && roots[BRIDGE_LANE(k)] < *h) {
            first = k;
            *h = roots[BRIDGE_LANE(k)];
        }
    }
    return first;
}

/* Phase k is at zero h seconds after the present parabola's beginning. True if the course is another one from there on; false,
 * with all as it was, if the segment has to end there. */
PLANT_INLINE bool pass_zero(course_t *c, pass_t *pass, const bridge_t *b, int k, double h, double u)
{
    if (c->floating >= 0 || c->passes == PASSES) {
        return false;
    }
    const bridge_frame_t *f = &b->frame;
    const unsigned leg = BRIDGE_LEG(k);
    const bool falls = (c->positive & leg) != 0u;
    const bool open = (b->gates & BRIDGE_BOTH(leg)) == 0u;
    const double most = 2.0 * b->v_drop + (open ? u : 0.0); /* from one end of the leg's interval to the other */
    const double rest = (c->end - c->from) - h;
    const lanes_t di = c->di + all(h) * c->ddi;
    const lanes_t needed = lanes_of(f->hold) * di;
    const unsigned held =
        (lanes_where(needed < all(most)) & c->positive) | (lanes_where(needed > all(-most)) & c->negative);
    lanes_t more, turn; /* of i', i'': in both branches, as through zero they need not wait for `needed` */
    pass_t *here = &pass[c->passes];
    here->slope = 0.0;
    if ((held & leg) == 0u) {
        if (open) {
            return false;
        }
        here->volts = falls ? most : -most;
        more = all(here->volts) * lanes_of(f->along[k]);
        turn = all(here->volts) * lanes_of(f->bend[k]);
        c->positive ^= leg;
        c->negative ^= leg;
    } else {
        here->volts = phase_of(needed, k);
        more = all(here->volts) * lanes_of(f->along[k]);
        turn = all(here->volts) * lanes_of(f->bend[k]);
        here->slope = phase_of(lanes_of(f->hold) * (c->ddi + turn), k);
        const double last = here->volts + here->slope * rest;
        if (falls ? !(here->volts > 0.0 && last > 0.0 && last < most)
                  : !(here->volts < 0.0 && last < 0.0 && last > -most)) {
            return false;
        }
        turn += all(here->slope) * lanes_of(f->along[k]);
        c->positive &= ~leg;
        c->negative &= ~leg;
        c->floating = k;
    }
    c->i = without(course_after(c, h), k);
    c->di = di + more;
    c->ddi += turn;
    c->last = (c->last + all(rest) * more) + all(rest * rest) * (all(0.5) * turn);
    c->from += h;
    here->phase = k;
    here->at = c->from;
    c->passes++;
    return true;
}

/* To the end of the segment, or to where that has to be: returns the leg whose current is at zero then, or -1. */
PLANT_INLINE int follow_course(course_t *c, pass_t *pass, const bridge_t *b, double u)
{
    for (;;) {
        const unsigned beyond = beyond_zero(c->last, c->positive, c->negative);
        if (beyond == 0u) {
            return -1;
        }
        double h;
        const int k = first_zero(c, beyond, &h);
        if (!pass_zero(c, pass, b, k, h, u)) {
            c->end = c->from + h;
            return k;
        }
    }
}

/* What the passes add to charge, impulse of the voltage and losses [A s], [V s], [J]; and what the amplifiers have not seen
 * of the slope at the end [A/s]. */
PLANT_INLINE void account_passes(const course_t *c, const pass_t *pass, const bridge_t *b, pair_t *charge,
                                 lanes_t *impulse, lanes_t *slope, double *lost)
{
    lanes_t more = all(0.0);
    for (const pass_t *past = pass + c->passes; pass < past; pass++) {
        const lanes_t along = lanes_of(b->frame.along[pass->phase]);
        const double h = c->end - pass->at;
        const double volt_seconds = h * (pass->volts + 0.5 * h * pass->slope);
        const double volt_seconds_2 = h * h * (pass->volts + THIRD * h * pass->slope); /* twice their integral */
        *charge += both(0.5 * volt_seconds_2) * vector(along);
        more += all(volt_seconds) * lanes_of(legs_at[BRIDGE_LEG(pass->phase)]);
        *slope -= all(pass->volts * decay(b, h)) * along;
    }
    *impulse += more;
    *lost -= 0.75 * sum(vector(more) * vector(c->last)); /* 3/2 v i, i on its way from zero straight to the end */
}

#endif

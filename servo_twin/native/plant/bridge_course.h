/* bridge_course.h - the currents of a segment on their way to its end; for bridge_frame.c alone.
 *
 * Where a phase's current comes to zero its leg goes to another voltage: with a gate on, the drop changes its sign, and the
 * current goes through if that lets it; or else the leg floats. Either way the segment goes on as another parabola. What
 * that adds to charge, impulse and losses follows from the volts and the moments; only the amplifiers and the square of the
 * current go by a straight line to the end, from which a leg that floats after some 20 mA in a dead time is 3 mA away for a
 * few of the amplifier's time constants. Where it can't go on so, the segment ends.
 */
#ifndef PLANT_BRIDGE_COURSE_H
#define PLANT_BRIDGE_COURSE_H

#include "plant/bridge_lanes.h"

#define STRAIGHT 0.05 /* bend of a current on its way through zero, of its fall, that a series is good for */
#define PASSES 4

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

PLANT_INLINE lanes_t course_at(const course_t *c, double t)
{
    const double h = t - c->from;
    return c->i + all(h) * (c->di + all(0.5 * h) * c->ddi);
}

PLANT_INLINE void start_course(course_t *c, const bridge_t *b, double end)
{
    const bridge_frame_t *f = &b->frame;
    c->from = 0.0;
    c->i = lanes_of(f->i);
    c->di = lanes_of(f->di);
    c->ddi = lanes_of(f->ddi);
    c->end = end;
    c->last = course_at(c, end);
    c->positive = b->positive;
    c->negative = b->negative;
    c->floating = b->floating;
    c->passes = 0;
}

/* Root within h of a parabola that goes from f0 to f1 on the other side of zero, with the slope d0: where its chord is at
 * zero, and the bend as a series. One that bends much is solved. */
PLANT_INLINE double chord_root(double f0, double f1, double d0, double h)
{
    const double bend = f1 - f0 - d0 * h;
    const double per_fall = 1.0 / (f0 - f1);
    const double part = f0 * per_fall;
    const double bent = bend * per_fall;
    if (part > 0.0 && part < 1.0 && bent < STRAIGHT && bent > -STRAIGHT) {
        return h * (part - bent * part * (1.0 - part) * (1.0 - bent * (1.0 - 2.0 * part)));
    }
    const double way = (f1 < 0.0) ? 1.0 : -1.0;
    return root_within(f0 * way, d0 * way, bend * way / (h * h), h);
}

/* Of the phases `beyond` zero at the end: which was the first to be there, and when. In branches, that a processor may go
 * on before it knows the answer. */
PLANT_INLINE int first_zero(const course_t *c, unsigned beyond, double *t)
{
    const double h = c->end - c->from;
    double soonest = h;
    int first = -1;
    for (int k = 0; k < 3; k++) {
        if ((beyond >> k & 1u) != 0u) {
            const int lane = BRIDGE_LANE(k);
            const double zero = chord_root(c->i[lane], c->last[lane], c->di[lane], h);
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
    if (c->floating >= 0 || b->shorted || c->passes == PASSES) {
        return false;
    }
    const bridge_frame_t *f = &b->frame;
    const unsigned leg = 1u << k;
    const bool falls = (c->positive & leg) != 0u;
    const bool open = ((b->upper | b->lower) & leg) == 0u;
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

/* What the passes add to charge, impulse of the voltage and losses [A s], [V s], [J]. */
PLANT_INLINE void account_passes(const course_t *c, const bridge_frame_t *f, pair_t *charge, lanes_t *impulse,
                                 double *lost)
{
    double last[BRIDGE_LANES];
    put_lanes(last, c->last);
    for (const pass_t *pass = c->pass; pass < c->pass + c->passes; pass++) {
        const double h = c->end - pass->at;
        const double volt_seconds = h * (pass->volts + 0.5 * h * pass->slope);
        const double volt_seconds_2 = h * h * (pass->volts + THIRD * h * pass->slope); /* twice their integral */
        *charge += both(THIRD * volt_seconds_2) * vector(lanes_of(f->along[pass->phase]));
        *impulse += all(volt_seconds) * lanes_of(legs_at[1u << pass->phase]);
        *lost -= 0.5 * volt_seconds * last[BRIDGE_LANE(pass->phase)];
    }
}

#endif

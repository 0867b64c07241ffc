/* segment_trajectory.h - the phase currents over one segment of a linear interval, with their zero crossings.
 * Internal: only switched_inverter_interval.c includes it.
 *
 * At a current zero crossing the voltage of the leg changes. With a gate on, the drop changes its sign and the current crosses
 * zero, if that lets it; otherwise the leg floats. In both cases the segment continues as another parabola. The changes of
 * charge, impulse of the voltage, losses and amplifier outputs follow from the voltage steps and their times; only the square
 * of the current is taken along a straight line to the end. Where no other parabola follows, the segment ends.
 */
#ifndef PLANT_SEGMENT_TRAJECTORY_H
#define PLANT_SEGMENT_TRAJECTORY_H

#include "plant/vector_lanes.h"

#define CURVATURE_MAX 0.05 /* curvature that the series for a root covers: change of slope over mean slope */
#define ZERO_CROSSINGS_MAX 4 /* in one segment */

/* Beginning of a segment. */
typedef struct {
    lanes_t i, di, ddi; /* [A], [A/s], [A/s^2] */
    lanes_t v;          /* leg voltages: alpha, beta, mean of the legs, unused [V] */
} segment_t;

typedef struct {
    int phase;
    double at;    /* since the beginning of the segment [s] */
    double volts; /* step of the leg's voltage [V] */
    double slope; /* step of its slope [V/s] */
} zero_crossing_t;

/* Kept in registers, which an array would prevent: the zero crossings are stored elsewhere. */
typedef struct {
    double from;                 /* beginning of the present parabola, at the last zero crossing [s] */
    lanes_t i, di, ddi;          /* at `from` [A], [A/s], [A/s^2] */
    double end;                  /* end of the segment [s] */
    lanes_t last;                /* current at `end` [A] */
    unsigned positive, negative; /* sets of legs by the sign of their current */
    int floating;                /* leg without current, -1: none known */
    int crossings;               /* number of zero crossings so far */
} trajectory_t;

PLANT_INLINE segment_t load_segment(const switched_inverter_t *inv)
{
    const linear_interval_t *interval = &inv->interval;
    return (segment_t){load_lanes(interval->i), load_lanes(interval->di), load_lanes(interval->ddi),
                       load_lanes(interval->v)};
}

PLANT_INLINE void store_segment(switched_inverter_t *inv, const segment_t *s)
{
    linear_interval_t *interval = &inv->interval;
    store_lanes(interval->i, s->i);
    store_lanes(interval->di, s->di);
    store_lanes(interval->ddi, s->ddi);
    store_lanes(interval->v, s->v);
    store_vector(&inv->di, vector(s->di));
}

/* Current h seconds after the beginning of the present parabola. */
PLANT_INLINE lanes_t current_after(const trajectory_t *c, double h)
{
    return (c->i + all(h) * c->di) + all(h * h) * (all(0.5) * c->ddi);
}

PLANT_INLINE lanes_t current_at(const trajectory_t *c, double t) { return current_after(c, t - c->from); }

PLANT_INLINE lanes_t slope_at(const trajectory_t *c, double t) { return c->di + all(t - c->from) * c->ddi; }

PLANT_INLINE void start_trajectory(trajectory_t *c, const switched_inverter_t *inv, const segment_t *s, double end)
{
    c->from = 0.0;
    c->i = s->i;
    c->di = s->di;
    c->ddi = s->ddi;
    c->end = end;
    c->last = current_at(c, end);
    c->positive = inv->positive;
    c->negative = inv->negative;
    c->floating = inv->floating;
    c->crossings = 0;
}

/* Roots of parabolas with initial slopes d0 within h, by phase: the root of the chord, corrected for the curvature by a series.
 * Returns the phases for which the series is accurate. */
PLANT_INLINE unsigned chord_roots(lanes_t f0, lanes_t f1, lanes_t d0, double h, lanes_t *root)
{
    const lanes_t per_fall = all(1.0) / (f0 - f1);
    const lanes_t part = f0 * per_fall;
    const lanes_t complement = -f1 * per_fall;
    const lanes_t curvature = (all(-h) * d0) * per_fall - all(1.0);
    const lanes_t skew = all(1.0) + curvature * ((f0 + f1) * per_fall);
    *root = all(h) * part - (all(h) * complement) * ((curvature * part) * skew);
    return legs_where((part > 0.0) & (complement > 0.0) & (curvature < CURVATURE_MAX) & (curvature > -CURVATURE_MAX));
}

/* Exact roots for the phases in `legs`; the others are kept. */
static PLANT_COLD void exact_roots(const double f0[INVERTER_LANES], const double f1[INVERTER_LANES],
                                   const double d0[INVERTER_LANES], double h, unsigned legs,
                                   double root[INVERTER_LANES])
{
    for (int k = 0; k < 3; k++) {
        if ((legs & INVERTER_LEG(k)) != 0u) {
            const int lane = INVERTER_LANE(k);
            const double sign = (f1[lane] < 0.0) ? 1.0 : -1.0;
            root[lane] = root_of(f0[lane] * sign, d0[lane] * sign, f1[lane] * sign, h);
        }
    }
}

PLANT_INLINE lanes_t roots_of(const trajectory_t *c, unsigned beyond, double h)
{
    lanes_t roots;
    const unsigned inexact = beyond & ~chord_roots(c->i, c->last, c->di, h, &roots);
    if (inexact != 0u) {
        double f0[INVERTER_LANES], f1[INVERTER_LANES], d0[INVERTER_LANES], root[INVERTER_LANES];
        store_lanes(f0, c->i);
        store_lanes(f1, c->last);
        store_lanes(d0, c->di);
        store_lanes(root, roots);
        exact_roots(f0, f1, d0, h, inexact, root);
        roots = load_lanes(root);
    }
    return roots;
}

/* The first current to cross zero of the phases `beyond` zero at the end, and *h seconds after the beginning of the parabola.
 * By branches, so that the processor can continue speculatively. */
PLANT_INLINE int first_crossing(const trajectory_t *c, unsigned beyond, double *h)
{
    const lanes_t roots = roots_of(c, beyond, c->end - c->from);
    int first = 0;
    *h = (beyond & LEG_A) != 0u ? roots[INVERTER_LANE(0)] : INFINITY;
    for (int k = 1; k < 3; k++) {
        if ((beyond & INVERTER_LEG(k)) != 0u && roots[INVERTER_LANE(k)] < *h) {
            first = k;
            *h = roots[INVERTER_LANE(k)];
        }
    }
    return first;
}

/* The current of phase k crosses zero h seconds after the beginning of the present parabola. True if another parabola follows;
 * false, with nothing changed, if the segment has to end there. */
PLANT_INLINE bool cross_zero(trajectory_t *c, zero_crossing_t *crossing, const switched_inverter_t *inv, int k,
                             double h, double u)
{
    if (c->floating >= 0 || c->crossings == ZERO_CROSSINGS_MAX) {
        return false;
    }
    const linear_interval_t *interval = &inv->interval;
    const unsigned leg = INVERTER_LEG(k);
    const bool falls = (c->positive & leg) != 0u;
    const bool open = (inv->gates & INVERTER_BOTH_GATES(leg)) == 0u;
    const double width = 2.0 * inv->v_drop + (open ? u : 0.0); /* width of the leg's voltage interval */
    const double rest = (c->end - c->from) - h;
    const lanes_t di = c->di + all(h) * c->ddi;
    const lanes_t needed = load_lanes(interval->minus_l_leg) * di; /* voltage step that makes the slope zero */
    const unsigned floats =
        (legs_where(needed < all(width)) & c->positive) | (legs_where(needed > all(-width)) & c->negative);
    lanes_t d_slope, d_curvature; /* computed in both branches: a crossing need not wait for `needed` */
    zero_crossing_t *here = &crossing[c->crossings];
    here->slope = 0.0;
    if ((floats & leg) == 0u) {
        if (open) {
            return false;
        }
        here->volts = falls ? width : -width;
        d_slope = all(here->volts) * load_lanes(interval->di_per_volt[k]);
        d_curvature = all(here->volts) * load_lanes(interval->ddi_per_volt[k]);
        c->positive ^= leg;
        c->negative ^= leg;
    } else {
        here->volts = phase_of(needed, k);
        d_slope = all(here->volts) * load_lanes(interval->di_per_volt[k]);
        d_curvature = all(here->volts) * load_lanes(interval->ddi_per_volt[k]);
        here->slope = phase_of(load_lanes(interval->minus_l_leg) * (c->ddi + d_curvature), k);
        const double last = here->volts + here->slope * rest;
        if (falls ? !(here->volts > 0.0 && last > 0.0 && last < width)
                  : !(here->volts < 0.0 && last < 0.0 && last > -width)) {
            return false;
        }
        d_curvature += all(here->slope) * load_lanes(interval->di_per_volt[k]);
        c->positive &= ~leg;
        c->negative &= ~leg;
        c->floating = k;
    }
    c->i = without(current_after(c, h), k);
    c->di = di + d_slope;
    c->ddi += d_curvature;
    c->last = (c->last + all(rest) * d_slope) + all(rest * rest) * (all(0.5) * d_curvature);
    c->from += h;
    here->phase = k;
    here->at = c->from;
    c->crossings++;
    return true;
}

/* Follow the currents to the end of the segment, or to the zero crossing that ends it. Returns the phase of the latter, or -1. */
PLANT_INLINE int follow_trajectory(trajectory_t *c, zero_crossing_t *crossing, const switched_inverter_t *inv, double u)
{
    for (;;) {
        const unsigned beyond = legs_beyond_zero(c->last, c->positive, c->negative);
        if (beyond == 0u) {
            return -1;
        }
        double h;
        const int k = first_crossing(c, beyond, &h);
        if (!cross_zero(c, crossing, inv, k, h, u)) {
            c->end = c->from + h;
            return k;
        }
    }
}

/* Add the effect of the zero crossings to charge [A s], impulse of the voltage [V s] and losses [J], and take the part that the
 * amplifiers have not yet followed from the slope at the end [A/s]. */
PLANT_INLINE void account_crossings(const trajectory_t *c, const zero_crossing_t *crossing,
                                    const switched_inverter_t *inv, pair_t *charge, lanes_t *impulse, lanes_t *slope,
                                    double *lost)
{
    lanes_t added = all(0.0);
    for (const zero_crossing_t *past = crossing + c->crossings; crossing < past; crossing++) {
        const lanes_t di_per_volt = load_lanes(inv->interval.di_per_volt[crossing->phase]);
        const double h = c->end - crossing->at;
        const double volt_seconds = h * (crossing->volts + 0.5 * h * crossing->slope);
        const double volt_seconds_2 =
            h * h * (crossing->volts + THIRD * h * crossing->slope); /* twice their integral */
        *charge += pair_of(0.5 * volt_seconds_2) * vector(di_per_volt);
        added += all(volt_seconds) * load_lanes(legs_at[INVERTER_LEG(crossing->phase)]);
        *slope -= all(crossing->volts * amplifier_decay(inv, h)) * di_per_volt;
    }
    *impulse += added;
    *lost -= 0.75 * sum(vector(added) * vector(c->last)); /* 3/2 v i, with i linear from zero to the end */
}

#endif

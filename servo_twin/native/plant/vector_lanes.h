/* vector_lanes.h - a stator vector and its phases in one vector register (INVERTER_LANES).
 * Internal: only switched_inverter_interval.c includes it.
 */
#ifndef PLANT_VECTOR_LANES_H
#define PLANT_VECTOR_LANES_H

#include <string.h>

#include "plant/switched_inverter_legs.h"

#pragma GCC diagnostic ignored "-Wpsabi" /* calling convention of vectors: all functions that take them are inlined */

typedef double pair_t __attribute__((vector_size(16))); /* alpha, beta */
typedef double lanes_t __attribute__((vector_size(32))); /* alpha, beta, phase b, phase c */
typedef int64_t masks_t __attribute__((vector_size(32)));

PLANT_INLINE pair_t load_vector(const plant_vector_t *x)
{
    pair_t pair;
    memcpy(&pair, x, sizeof pair);
    return pair;
}

PLANT_INLINE void store_vector(plant_vector_t *x, pair_t pair) { memcpy(x, &pair, sizeof *x); }

PLANT_INLINE pair_t pair_of(double x) { return (pair_t){x, x}; }

PLANT_INLINE pair_t load_pair(const double x[2])
{
    pair_t pair;
    memcpy(&pair, x, sizeof pair);
    return pair;
}

PLANT_INLINE void store_pair(double x[2], pair_t pair) { memcpy(x, &pair, sizeof pair); }

PLANT_INLINE double sum(pair_t x) { return x[0] + x[1]; }

PLANT_INLINE lanes_t load_lanes(const double x[INVERTER_LANES])
{
    lanes_t lanes;
    memcpy(&lanes, x, sizeof lanes);
    return lanes;
}

PLANT_INLINE void store_lanes(double x[INVERTER_LANES], lanes_t lanes) { memcpy(x, &lanes, sizeof lanes); }

PLANT_INLINE lanes_t all(double x) { return (lanes_t){x, x, x, x}; }

/* The stator vector alone. */
PLANT_INLINE pair_t vector(lanes_t x)
{
    pair_t pair;
    memcpy(&pair, &x, sizeof pair);
    return pair;
}

/* A stator vector with its phases. */
PLANT_INLINE lanes_t lanes_of(double alpha, double beta)
{
    const lanes_t with_alpha = {1.0, 0.0, -0.5, -0.5};
    const lanes_t with_beta = {0.0, 1.0, HALF_SQRT3, -HALF_SQRT3};
    return all(alpha) * with_alpha + all(beta) * with_beta;
}

/* Product of a matrix, given by its columns, and a stator vector. */
PLANT_INLINE lanes_t product(const double column[2][INVERTER_LANES], lanes_t x)
{
    return load_lanes(column[0]) * all(x[0]) + load_lanes(column[1]) * all(x[1]);
}

/* The same plus an offset. Added first, as it is available before the vector. */
PLANT_INLINE lanes_t product_plus(const double column[2][INVERTER_LANES], lanes_t x, lanes_t offset)
{
    return (offset + load_lanes(column[0]) * all(x[0])) + load_lanes(column[1]) * all(x[1]);
}

PLANT_INLINE double phase_of(lanes_t x, int k)
{
#ifdef __AVX2__ /* faster than through memory */
    typedef int32_t halves_t __attribute__((vector_size(32)));
    static const int32_t lane[3][8] PLANT_ALIGNED = {
        {0, 1, 0, 1, 0, 1, 0, 1}, {4, 5, 4, 5, 4, 5, 4, 5}, {6, 7, 6, 7, 6, 7, 6, 7}};
    halves_t halves, from;
    memcpy(&halves, &x, sizeof halves);
    memcpy(&from, lane[k], sizeof from);
    halves = __builtin_ia32_permvarsi256(halves, from);
    memcpy(&x, &halves, sizeof x);
    return x[0];
#else
    double lane[INVERTER_LANES];
    store_lanes(lane, x);
    return lane[INVERTER_LANE(k)];
#endif
}

/* The same lanes with +0 in phase k. */
PLANT_INLINE lanes_t without(lanes_t x, int k)
{
    static const int64_t keep[3][INVERTER_LANES] PLANT_ALIGNED = {{0, -1, -1, -1}, {-1, -1, 0, -1}, {-1, -1, -1, 0}};
    masks_t bits, kept;
    memcpy(&bits, &x, sizeof bits);
    memcpy(&kept, keep[k], sizeof kept);
    bits &= kept;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* Lanes whose sign bit or whole mask is set, as a set of legs; the bit of lane beta has no meaning. */
PLANT_INLINE unsigned legs_where(masks_t x)
{
#ifdef __AVX__
    lanes_t signs;
    memcpy(&signs, &x, sizeof signs);
    return (unsigned)__builtin_ia32_movmskpd256(signs);
#else
    return (x[0] < 0 ? LEG_A : 0u) | (x[2] < 0 ? LEG_B : 0u) | (x[3] < 0 ? LEG_C : 0u);
#endif
}

/* Lanes below zero. None is ever -0, which only a sum of terms that are all -0 would be. */
PLANT_INLINE unsigned legs_below_zero(lanes_t x)
{
    masks_t bits;
    memcpy(&bits, &x, sizeof bits);
    return legs_where(bits);
}

/* Phases whose current has the opposite sign of the one recorded in `positive` and `negative`. */
PLANT_INLINE unsigned legs_beyond_zero(lanes_t x, unsigned positive, unsigned negative)
{
    const unsigned below = legs_below_zero(x);
    return (below & positive) | (negative & ~below);
}

#endif

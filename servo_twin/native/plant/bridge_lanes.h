/* bridge_lanes.h - a stator vector together with its phases in one register; for bridge_frame.c alone. */
#ifndef PLANT_BRIDGE_LANES_H
#define PLANT_BRIDGE_LANES_H

#include <string.h>

#include "plant/bridge_kernel.h"

#pragma GCC diagnostic ignored "-Wpsabi" /* how lanes are passed: never, all functions of them are inlined */

typedef double pair_t __attribute__((vector_size(16))); /* alpha, beta */
typedef double lanes_t __attribute__((vector_size(32))); /* see BRIDGE_LANES */
typedef int64_t sides_t __attribute__((vector_size(32)));

PLANT_INLINE pair_t pair_of(const plant_vector_t *x)
{
    pair_t pair;
    memcpy(&pair, x, sizeof pair);
    return pair;
}

PLANT_INLINE void put(plant_vector_t *x, pair_t pair) { memcpy(x, &pair, sizeof *x); }

PLANT_INLINE pair_t both(double x) { return (pair_t){x, x}; }

PLANT_INLINE pair_t pair_at(const double x[2])
{
    pair_t pair;
    memcpy(&pair, x, sizeof pair);
    return pair;
}

PLANT_INLINE void put_pair(double x[2], pair_t pair) { memcpy(x, &pair, sizeof pair); }

PLANT_INLINE double sum(pair_t x) { return x[0] + x[1]; }

PLANT_INLINE lanes_t lanes_of(const double x[BRIDGE_LANES])
{
    lanes_t lanes;
    memcpy(&lanes, x, sizeof lanes);
    return lanes;
}

PLANT_INLINE void put_lanes(double x[BRIDGE_LANES], lanes_t lanes) { memcpy(x, &lanes, sizeof lanes); }

PLANT_INLINE lanes_t all(double x) { return (lanes_t){x, x, x, x}; }

/* The stator vector alone. */
PLANT_INLINE pair_t vector(lanes_t x)
{
    pair_t pair;
    memcpy(&pair, &x, sizeof pair);
    return pair;
}

/* A stator vector with its phases. */
PLANT_INLINE lanes_t spread(double alpha, double beta)
{
    const lanes_t with_alpha = {1.0, 0.0, -0.5, -0.5};
    const lanes_t with_beta = {0.0, 1.0, HALF_SQRT3, -HALF_SQRT3};
    return all(alpha) * with_alpha + all(beta) * with_beta;
}

/* Of a matrix, by columns, with a stator vector. */
PLANT_INLINE lanes_t product(const double column[2][BRIDGE_LANES], lanes_t x)
{
    return lanes_of(column[0]) * all(x[0]) + lanes_of(column[1]) * all(x[1]);
}

/* The same, added to what is there before the vector is. */
PLANT_INLINE lanes_t product_and(const double column[2][BRIDGE_LANES], lanes_t x, lanes_t more)
{
    return (more + lanes_of(column[0]) * all(x[0])) + lanes_of(column[1]) * all(x[1]);
}

PLANT_INLINE double phase_of(lanes_t x, int k)
{
#ifdef __AVX2__ /* sooner there than by way of the memory */
    typedef int32_t halves_t __attribute__((vector_size(32)));
    static const int32_t lane[3][8] PLANT_VECTORS = {
        {0, 1, 0, 1, 0, 1, 0, 1}, {4, 5, 4, 5, 4, 5, 4, 5}, {6, 7, 6, 7, 6, 7, 6, 7}};
    halves_t halves, from;
    memcpy(&halves, &x, sizeof halves);
    memcpy(&from, lane[k], sizeof from);
    halves = __builtin_ia32_permvarsi256(halves, from);
    memcpy(&x, &halves, sizeof x);
    return x[0];
#else
    double lane[BRIDGE_LANES];
    put_lanes(lane, x);
    return lane[BRIDGE_LANE(k)];
#endif
}

/* The same with nothing in phase k, not even a sign. */
PLANT_INLINE lanes_t without(lanes_t x, int k)
{
    static const int64_t keep[3][BRIDGE_LANES] PLANT_VECTORS = {{0, -1, -1, -1}, {-1, -1, 0, -1}, {-1, -1, -1, 0}};
    sides_t bits, kept;
    memcpy(&bits, &x, sizeof bits);
    memcpy(&kept, keep[k], sizeof kept);
    bits &= kept;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* Lanes of which the sign is set, or all bits: those of the phases are the bits of legs, and that of beta says nothing. */
PLANT_INLINE unsigned lanes_where(sides_t x)
{
#ifdef __AVX__
    lanes_t signs;
    memcpy(&signs, &x, sizeof signs);
    return (unsigned)__builtin_ia32_movmskpd256(signs);
#else
    return (x[0] < 0 ? LEG_A : 0u) | (x[2] < 0 ? LEG_B : 0u) | (x[3] < 0 ? LEG_C : 0u);
#endif
}

/* Lanes below zero. None is ever at -0: that takes terms that all are. */
PLANT_INLINE unsigned below_zero(lanes_t x)
{
    sides_t bits;
    memcpy(&bits, &x, sizeof bits);
    return lanes_where(bits);
}

/* Phases that are not on their sides. */
PLANT_INLINE unsigned beyond_zero(lanes_t x, unsigned positive, unsigned negative)
{
    const unsigned below = below_zero(x);
    return (below & positive) | (negative & ~below);
}

#endif

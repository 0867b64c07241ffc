/* trig.h - sine and cosine from additions and products only, with the same bits on every processor; libm selects its code by
 * processor. */
#ifndef PLANT_TRIG_H
#define PLANT_TRIG_H

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#define PLANT_PI 3.14159265358979323846
#define PLANT_SQRT3 1.73205080756887729353

/* Taylor series on [-pi/4, pi/4], where sixteen powers reach double precision. Even and odd terms are summed separately, which
 * halves the chain of dependent products. */
static inline void plant_sincos(double angle, double *sine, double *cosine)
{
    /* adding 1.5 x 2^52 rounds to an integer, whose low bits are the quadrant */
    const double shifted = angle * (2.0 / PLANT_PI) + 6755399441055744.0;
    const double quarter = shifted - 6755399441055744.0;
    uint64_t bits;
    memcpy(&bits, &shifted, sizeof bits);
    /* pi/2 in two parts: the first ends in zero bits, so its product with up to some million quadrants is exact */
    const double x = (angle - quarter * 1.57079632673412561417) - quarter * 6.07710050650619224932e-11;
    const double z = x * x;
    const double w = z * z;
    const double s_even = 1.0 + w * (1.0 / 120.0 + w * (1.0 / 362880.0 + w * (1.0 / 6227020800.0)));
    const double s_odd = -1.0 / 6.0 + w * (-1.0 / 5040.0 + w * (-1.0 / 39916800.0 + w * (-1.0 / 1307674368000.0)));
    const double c_even =
        1.0 + w * (1.0 / 24.0 + w * (1.0 / 40320.0 + w * (1.0 / 479001600.0 + w * (1.0 / 20922789888000.0))));
    const double c_odd = -0.5 + w * (-1.0 / 720.0 + w * (-1.0 / 3628800.0 + w * (-1.0 / 87178291200.0)));
    const double s = x * (s_even + z * s_odd);
    const double c = c_even + z * c_odd;
    const bool odd = (bits & 1u) != 0;
    const double first = odd ? c : s;
    const double second = odd ? s : c;
    *sine = ((bits & 2u) != 0) ? -first : first;
    *cosine = (((bits + 1u) & 2u) != 0) ? -second : second;
}

#endif

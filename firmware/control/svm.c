#include "control/svm.h"

#define ONE_BY_SQRT3_Q15 INT32_C(18919)
#define FULL INT32_C(32767)

svm_t svm(ab_t modulation)
{
    /* Projections on the normals of the three sector borders. In every sector two of them, with sign, are the active
     * times of E28 and E29 as parts of the period. */
    const int32_t alpha = modulation.alpha;
    const int32_t beta_by_sqrt3 = asr32(modulation.beta * ONE_BY_SQRT3_Q15 + INT32_C(0x4000), 15);
    const int32_t x = 2 * beta_by_sqrt3;
    const int32_t y = beta_by_sqrt3 + alpha;
    const int32_t z = beta_by_sqrt3 - alpha;

    svm_t result;
    int32_t t_single; /* time of the active vector with one high phase: U0, U120 or U240 */
    int32_t t_double; /* time of the one with two: U60, U180 or U300 */
    if (x >= 0) {
        if (z < 0) {
            result.sector = 1;
            t_single = -z;
            t_double = x;
        } else if (y >= 0) {
            result.sector = 2;
            t_single = z;
            t_double = y;
        } else {
            result.sector = 3;
            t_single = x;
            t_double = -y;
        }
    } else if (z >= 0) {
        result.sector = 4;
        t_single = -x;
        t_double = z;
    } else if (y < 0) {
        result.sector = 5;
        t_single = -y;
        t_double = -z;
    } else {
        result.sector = 6;
        t_single = y;
        t_double = -x;
    }

    const int32_t active = t_single + t_double;
    if (active > FULL) {
        t_single = t_single * FULL / active;
        t_double = FULL - t_single;
    }
    /* E30: the zero time is shared between O000 and O111, which centres the pulses. */
    const int32_t t_zero_half = (FULL - t_single - t_double) / 2;
    const frac16_t least = (frac16_t)t_zero_half;
    const frac16_t middle = (frac16_t)(t_zero_half + t_double);
    const frac16_t most = (frac16_t)(t_zero_half + t_single + t_double);

    switch (result.sector) {
    case 1:
        result.duty = (abc_t){most, middle, least};
        break;
    case 2:
        result.duty = (abc_t){middle, most, least};
        break;
    case 3:
        result.duty = (abc_t){least, most, middle};
        break;
    case 4:
        result.duty = (abc_t){least, middle, most};
        break;
    case 5:
        result.duty = (abc_t){middle, least, most};
        break;
    default:
        result.duty = (abc_t){most, least, middle};
        break;
    }
    return result;
}

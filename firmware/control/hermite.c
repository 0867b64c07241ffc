#include "control/hermite.h"

#include "math/divide.h"

#define PART_BITS 30
#define PERIODS_BITS 3 /* of HERMITE_PERIODS */

/* 2^62 / divisor for a divisor from 2^31 on: the first 15 bits by division, the others by one step of Newton. */
static uint32_t reciprocal_of(uint32_t divisor)
{
    const uint32_t guess = UINT32_MAX / (divisor >> 16) << 14;
    const int64_t error = (INT64_C(1) << 62) - (int64_t)((uint64_t)divisor * guess);
    return (uint32_t)((int64_t)guess + asr64(asr64(error, 16) * (int64_t)guess, 46));
}

/* Number of left shifts that normalise a non-zero number to 2^31 or more. */
static uint16_t normalisation(uint32_t x)
{
    uint16_t shift = 0;
    for (; (x & UINT32_C(0x80000000)) == 0U; x <<= 1) {
        shift++;
    }
    return shift;
}

/* x factor / 2^30, for a factor up to 2^31 and |x| < 2^55. */
static path_position_t scaled(path_position_t x, uint32_t factor)
{
    const int64_t high = asr64(x, PATH_BITS);
    const int64_t low = path_part(x);
    return asr64(high * (int64_t)factor, PART_BITS - PATH_BITS) + asr64(low * (int64_t)factor, PART_BITS);
}

static path_position_t magnitude(path_position_t x) { return (x < 0) ? -x : x; }

void hermite_set(hermite_t *segment, hermite_state_t from, hermite_state_t to, uint32_t duration)
{
    const path_position_t distance = to.position - from.position;
    const path_position_t begin = asr64(from.step * (int64_t)duration, PERIODS_BITS);
    const path_position_t end = asr64(to.step * (int64_t)duration, PERIODS_BITS);
    segment->origin = from.position;
    segment->c1 = begin;
    segment->c2 = 3 * distance - 2 * begin - end;
    segment->c3 = begin + end - 2 * distance;
    segment->duration = duration;
    segment->shift = normalisation(duration);
    segment->reciprocal = reciprocal_of(duration << segment->shift);
}

uint32_t hermite_part(const hermite_t *segment, uint32_t elapsed)
{
    return (uint32_t)((uint64_t)(elapsed << segment->shift) * segment->reciprocal >> 32);
}

path_position_t hermite_position(const hermite_t *segment, uint32_t elapsed)
{
    const uint32_t part = hermite_part(segment, elapsed);
    const path_position_t bend = segment->c2 + scaled(segment->c3, part);
    return segment->origin + scaled(segment->c1 + scaled(bend, part), part);
}

/* ---- limits ------------------------------------------------------------------------------------------------------- */

static path_position_t spare(path_position_t limit) { return limit + asr64(limit, 6) + 1; }

/* Speed maximum within the segment: at s = -c2 / (3 c3) the speed is c1 + c2 s. */
static path_position_t peak_speed(const hermite_t *segment)
{
    uint64_t above = (uint64_t)magnitude(segment->c2);
    uint64_t below = (uint64_t)(3 * magnitude(segment->c3));
    while (below > UINT32_MAX) {
        below >>= 1;
        above >>= 1;
    }
    const uint16_t shift = normalisation((uint32_t)below);
    const uint32_t divisor = (uint32_t)below << shift;
    const uint32_t part = (uint32_t)((above << shift) * reciprocal_of(divisor) >> 32);
    return segment->c1 + scaled(segment->c2, part);
}

bool hermite_speed_within(const hermite_t *segment, path_position_t step_max)
{
    const path_position_t limit = asr64(spare(step_max) * (int64_t)segment->duration, PERIODS_BITS);
    const path_position_t turn = segment->c2 + 3 * segment->c3;
    const path_position_t end = segment->c1 + segment->c2 + turn;
    if (magnitude(segment->c1) > limit || magnitude(end) > limit) {
        return false;
    }
    const bool inside = (segment->c2 < 0) ? turn > 0 : (segment->c2 > 0 && turn < 0);
    return !inside || magnitude(peak_speed(segment)) <= limit;
}

bool hermite_acceleration_within(const hermite_t *segment, path_position_t acceleration_max)
{
    /* Acceleration at both ends, per segment squared: 2 c2 and 2 c2 + 6 c3. A difference of two parts in 2^24 is
     * rounding. */
    const path_position_t limit =
        (spare(acceleration_max) + (INT32_C(1) << (PATH_BITS - 9))) * (int64_t)segment->duration;
    const path_position_t ends[] = {segment->c2, segment->c2 + 3 * segment->c3};
    for (uint16_t i = 0; i < 2U; i++) {
        const path_position_t over = scaled(magnitude(ends[i]), segment->reciprocal);
        if (asr64(over, 32U - segment->shift) * (INT32_C(1) << (2 * PERIODS_BITS + 1)) > limit) {
            return false;
        }
    }
    return true;
}

void hermite_reach(const hermite_t *segment, path_position_t *min, path_position_t *max)
{
    const path_position_t end = segment->c1 + segment->c2 + segment->c3;
    const path_position_t third = i64_over_u16(segment->c1, 3);
    const path_position_t points[] = {third, 2 * third + i64_over_u16(segment->c2, 3), end};
    *min = 0;
    *max = 0;
    for (uint16_t i = 0; i < 3U; i++) {
        *min = (points[i] < *min) ? points[i] : *min;
        *max = (points[i] > *max) ? points[i] : *max;
    }
}

#include "math/trig.h"

/* sin(pi/2 i/256) in Q1.15, one quarter wave and its end point. Linear interpolation between neighbours is off by at
 * most (pi/512)^2 / 8 = 4.7e-6, a seventh of one LSB. */
#define QUARTER_STEPS 256
/* clang-format off */
static const int16_t quarter_wave[QUARTER_STEPS + 1] = {
    0, 201, 402, 603, 804, 1005, 1206, 1407, 1608, 1809, 2009, 2210,
    2411, 2611, 2811, 3012, 3212, 3412, 3612, 3812, 4011, 4211, 4410, 4609,
    4808, 5007, 5205, 5404, 5602, 5800, 5998, 6195, 6393, 6590, 6787, 6983,
    7180, 7376, 7571, 7767, 7962, 8157, 8351, 8546, 8740, 8933, 9127, 9319,
    9512, 9704, 9896, 10088, 10279, 10469, 10660, 10850, 11039, 11228, 11417, 11605,
    11793, 11980, 12167, 12354, 12540, 12725, 12910, 13095, 13279, 13463, 13646, 13828,
    14010, 14192, 14373, 14553, 14733, 14912, 15091, 15269, 15447, 15624, 15800, 15976,
    16151, 16326, 16500, 16673, 16846, 17018, 17190, 17361, 17531, 17700, 17869, 18037,
    18205, 18372, 18538, 18703, 18868, 19032, 19195, 19358, 19520, 19681, 19841, 20001,
    20160, 20318, 20475, 20632, 20788, 20943, 21097, 21251, 21403, 21555, 21706, 21856,
    22006, 22154, 22302, 22449, 22595, 22740, 22884, 23028, 23170, 23312, 23453, 23593,
    23732, 23870, 24008, 24144, 24279, 24414, 24548, 24680, 24812, 24943, 25073, 25202,
    25330, 25457, 25583, 25708, 25833, 25956, 26078, 26199, 26320, 26439, 26557, 26674,
    26791, 26906, 27020, 27133, 27246, 27357, 27467, 27576, 27684, 27791, 27897, 28002,
    28106, 28209, 28311, 28411, 28511, 28610, 28707, 28803, 28899, 28993, 29086, 29178,
    29269, 29359, 29448, 29535, 29622, 29707, 29792, 29875, 29957, 30038, 30118, 30196,
    30274, 30350, 30425, 30499, 30572, 30644, 30715, 30784, 30853, 30920, 30986, 31050,
    31114, 31177, 31238, 31298, 31357, 31415, 31471, 31527, 31581, 31634, 31686, 31737,
    31786, 31834, 31881, 31927, 31972, 32015, 32058, 32099, 32138, 32177, 32214, 32251,
    32286, 32319, 32352, 32383, 32413, 32442, 32470, 32496, 32522, 32546, 32568, 32590,
    32610, 32629, 32647, 32664, 32679, 32693, 32706, 32718, 32729, 32738, 32746, 32753,
    32758, 32762, 32766, 32767, 32767,
};
/* clang-format on */

/* Sine of a phase in the first quarter: 0..0x4000 is 0..pi/2. */
static frac16_t quarter_sine(uint16_t phase)
{
    const uint16_t index = (uint16_t)(phase >> 6);
    const int32_t rest = (int32_t)(phase & 0x3FU);
    const int32_t low = quarter_wave[index];
    if (rest == 0) {
        return (frac16_t)low;
    }
    return (frac16_t)(low + asr32((quarter_wave[index + 1U] - low) * rest + 32, 6));
}

/* Sine of a phase over the full turn: 0..0xFFFF is 0..2 pi. */
static frac16_t sine(uint16_t phase)
{
    const uint16_t in_half = (uint16_t)(phase & 0x7FFFU);
    const uint16_t in_quarter = (in_half > 0x4000U) ? (uint16_t)(0x8000U - in_half) : in_half;
    const frac16_t magnitude = quarter_sine(in_quarter);
    return ((phase & 0x8000U) != 0U) ? (frac16_t)-magnitude : magnitude;
}

sin_cos_t sin_cos(frac16_t angle)
{
    const uint16_t phase = (uint16_t)angle;
    const sin_cos_t result = {sine(phase), sine((uint16_t)(phase + 0x4000U))};
    return result;
}

frac16_t f16_sqrt(frac32_t x)
{
    if (x <= 0) {
        return 0;
    }
    /* sqrt(raw / 2^31) x 2^15 = sqrt(raw / 2): digit by digit, most significant bit first. */
    uint32_t rest = (uint32_t)x >> 1;
    uint32_t root = 0;
    for (uint32_t bit = UINT32_C(1) << 28; bit != 0U; bit >>= 2) {
        const uint32_t trial = root + bit;
        root >>= 1;
        if (rest >= trial) {
            rest -= trial;
            root += bit;
        }
    }
    return (frac16_t)root;
}

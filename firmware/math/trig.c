#include "math/trig.h"

/* clang-format off */
const int16_t trig_quarter_wave[TRIG_QUARTER_STEPS + 1] = {
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

/* One Heron step towards sqrt(square). */
static uint32_t nearer(uint32_t root, uint32_t square) { return (root + square / root) >> 1; }

frac16_t f16_sqrt(frac32_t x)
{
    if (x < 2) {
        return 0;
    }
    /* sqrt(raw / 2^31) x 2^15 = sqrt(raw / 2). Starting at a power of two of at most twice the root, four steps reduce
     * an error of 100 % to 5e-8. */
    const uint32_t square = (uint32_t)x >> 1;
    uint32_t rest = square;
    uint32_t root = 2;
    if (rest >= UINT32_C(1) << 16) {
        rest >>= 16;
        root <<= 8;
    }
    if (rest >= UINT32_C(1) << 8) {
        rest >>= 8;
        root <<= 4;
    }
    if (rest >= UINT32_C(1) << 4) {
        rest >>= 4;
        root <<= 2;
    }
    if (rest >= UINT32_C(1) << 2) {
        root <<= 1;
    }
    root = nearer(nearer(nearer(nearer(root, square), square), square), square);
    return (frac16_t)((root * root > square) ? root - 1U : root);
}

#define EIGHTH INT32_C(8192) /* fraction of a turn */
#define BULGE INT32_C(2847)  /* atan(r) = r (pi/4 + 0.273 (1 - r)) approximately, r in 0 .. 1 */

frac16_t f16_angle(frac16_t x, frac16_t y)
{
    const int32_t across = (x < 0) ? -(int32_t)x : x;
    const int32_t up = (y < 0) ? -(int32_t)y : y;
    const bool steep = up > across;
    const int32_t max = steep ? up : across;
    const int32_t ratio = (steep ? across : up) * INT32_C(32768) / ((max > 0) ? max : 1);
    int32_t angle = asr32(ratio * (EIGHTH + asr32(BULGE * (32768 - ratio), 15)), 15);
    if (steep) {
        angle = 2 * EIGHTH - angle;
    }
    if (x < 0) {
        angle = 4 * EIGHTH - angle;
    }
    return (frac16_t)(uint16_t)((y < 0) ? -angle : angle);
}

sin_cos_t sin_cos_of(frac16_t angle) { return sin_cos(angle); }

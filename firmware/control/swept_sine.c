#include "control/swept_sine.h"

#include "math/trig.h"

#define STEP_MAX UINT32_C(0x7FFFFFFF)

frac16_t swept_sine_step(swept_sine_t *sine)
{
    if (sine->calls == 0U) {
        return 0;
    }
    sine->calls--;
    const sin_cos_t at = sin_cos_of((frac16_t)(uint16_t)(sine->phase >> 16));
    sine->phase += sine->step;
    sine->step += (uint32_t)(((uint64_t)sine->step * sine->growth) >> 32);
    sine->step = (sine->step > STEP_MAX) ? STEP_MAX : sine->step;
    return sat16(asr32((int32_t)sine->amplitude * at.sin + INT32_C(0x4000), 15));
}

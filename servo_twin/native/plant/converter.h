/* converter.h - codes of the 12-bit converter. */
#ifndef PLANT_CONVERTER_H
#define PLANT_CONVERTER_H

#include <stdint.h>

#define PLANT_CODE_MAX 4095
#define PLANT_SINK_FULL_SCALE 150.0 /* [deg C] at full scale of the converter */

/* Nearest code of a 12-bit converter, saturated at 0 and 4095. */
static inline uint16_t plant_code(double code)
{
    if (code <= 0.0) {
        return 0;
    }
    return (code >= (double)PLANT_CODE_MAX) ? (uint16_t)PLANT_CODE_MAX : (uint16_t)(code + 0.5);
}

/* Code of a unipolar signal: 24 V of 36.3 V is 2708 (DRM E46). */
static inline uint16_t plant_code_unipolar(double value, double full_scale)
{
    return plant_code(value / full_scale * 4096.0);
}

#endif

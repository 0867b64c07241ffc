/* converter.h - codes of the 12-bit converters of a board. */
#ifndef PLANT_CONVERTER_H
#define PLANT_CONVERTER_H

#include <math.h>
#include <stdint.h>

#define PLANT_CODE_MAX 4095

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

/* Code of the temperature sensor of a power stage. */
static inline uint16_t plant_code_sink(double celsius)
{
#if defined(BOARD_ODRIVE36) /* thermistor of 10 kohm and a beta of 3434 K from the supply, 3.3 kohm to ground */
    const double resistance = 10e3 * exp(3434.0 * (1.0 / (celsius + 273.15) - 1.0 / 298.15));
    return plant_code_unipolar(3.3e3 / (3.3e3 + resistance), 1.0);
#else /* linearised */
    return plant_code_unipolar(celsius, 150.0);
#endif
}

#endif

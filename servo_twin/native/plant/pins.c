#include "plant/pins.h"

#include <math.h>

void plant_pins_change(plant_pins_t *pins, const plant_axis_t *config)
{
    pins->home_from = config->home_from;
    pins->home_to = config->home_to;
    pins->limit_min = config->limit_min;
    pins->limit_max = config->limit_max;
    pins->enabled = config->enable_closed != 0.0;
    pins->friction = config->friction;
    pins->torque = config->brake_torque;
    pins->open_time = config->brake_open_time;
    pins->close_time = config->brake_close_time;
}

void plant_pins_init(plant_pins_t *pins, const plant_axis_t *config)
{
    *pins = (plant_pins_t){.holds = true, .due = INFINITY};
    plant_pins_change(pins, config);
}

unsigned plant_pins_closed(const plant_pins_t *pins, double theta)
{
    const bool closed[] = {
        [BOARD_PIN_HOME] = theta >= pins->home_from && theta <= pins->home_to,
        [BOARD_PIN_LIMIT_MIN] = theta > pins->limit_min,
        [BOARD_PIN_LIMIT_MAX] = theta < pins->limit_max,
        [BOARD_PIN_ENABLE] = pins->enabled,
    };
    unsigned bits = 0;
    for (unsigned pin = 0; pin < sizeof closed / sizeof closed[0]; pin++) {
        bits |= closed[pin] ? 1u << pin : 0u;
    }
    return bits & ~pins->cut;
}

static void follow_coil(plant_pins_t *pins, double now)
{
    const bool coil = pins->powered && (pins->cut & (1u << BOARD_PIN_BRAKE)) == 0u;
    if (coil != pins->coil) {
        pins->coil = coil;
        pins->due = now + (coil ? pins->open_time : pins->close_time);
    }
}

void plant_pins_power(plant_pins_t *pins, bool on, double now)
{
    pins->powered = on;
    follow_coil(pins, now);
}

void plant_pins_cut(plant_pins_t *pins, int pin, bool cut, double now)
{
    const unsigned bit = 1u << pin;
    pins->cut = cut ? (pins->cut | bit) : (pins->cut & ~bit);
    follow_coil(pins, now);
}

bool plant_pins_follow(plant_pins_t *pins, double now)
{
    if (now < pins->due) {
        return false;
    }
    pins->due = INFINITY;
    pins->holds = !pins->coil;
    return true;
}

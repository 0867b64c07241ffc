/* pins.h - switches, enable circuit and holding brake of one axis; the same on both levels of the plant. */
#ifndef PLANT_PINS_H
#define PLANT_PINS_H

#include <stdbool.h>

#include "board.h"

typedef struct {
    double home_from, home_to;   /* the home switch is closed between these angles [rad] */
    double limit_min, limit_max; /* the limit switches are open from there on [rad] */
    bool enabled;                /* the enable circuit is closed */
    double friction;             /* of the shaft [N m] */
    double torque;               /* that the brake holds; 0: there is none [N m] */
    double open_time, close_time; /* [s] */
    unsigned cut;                /* wires, a bit per board_pin_t */
    bool powered;                /* the chip gives the coil its current .. */
    bool coil;                   /* .. and its wire is whole */
    bool holds;
    double due;                  /* when the brake follows its coil [s] */
} plant_pins_t;

void plant_pins_init(plant_pins_t *pins, const plant_axis_t *config);

/* Other switches, another friction and brake from now on. */
void plant_pins_change(plant_pins_t *pins, const plant_axis_t *config);

/* Contacts that are closed with the shaft at `theta`, a bit per board_pin_t. */
unsigned plant_pins_closed(const plant_pins_t *pins, double theta);

/* The coil is switched, or its wire is cut, at `now`. */
void plant_pins_power(plant_pins_t *pins, bool on, double now);
void plant_pins_cut(plant_pins_t *pins, int pin, bool cut, double now);

/* True if the brake has followed its coil by now. */
bool plant_pins_follow(plant_pins_t *pins, double now);

/* Friction of the shaft with its brake [N m]. */
static inline double plant_pins_friction(const plant_pins_t *pins)
{
    return pins->friction + (pins->holds ? pins->torque : 0.0);
}

#endif

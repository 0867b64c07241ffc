/* pins.h - switches, enable circuit and holding brake of one axis, for both levels of the plant. */
#ifndef PLANT_PINS_H
#define PLANT_PINS_H

#include <stdbool.h>

#include "board.h"

typedef struct {
    double home_from, home_to;   /* the home switch is closed between these angles [rad] */
    double limit_min, limit_max; /* the limit switches open at these angles [rad] */
    bool enabled;                /* the enable circuit is closed */
    double friction;             /* Coulomb friction of the shaft [N m] */
    double torque;               /* holding torque of the brake; 0: no brake [N m] */
    double open_time, close_time; /* delay behind the coil [s] */
    unsigned cut;                /* broken wires, a bit per board_pin_t */
    bool powered;                /* output of the chip for the coil */
    bool coil;                   /* the coil has current */
    bool holds;                  /* the brake is closed */
    double due;                  /* time at which the brake follows its coil [s] */
} plant_pins_t;

void plant_pins_init(plant_pins_t *pins, const plant_axis_t *config);

/* New parameters; the state is kept. */
void plant_pins_change(plant_pins_t *pins, const plant_axis_t *config);

/* Closed contacts with the shaft at `theta` [rad], a bit per board_pin_t. */
unsigned plant_pins_closed(const plant_pins_t *pins, double theta);

/* Switch the coil, or break or repair a wire, at the time `now` [s]. */
void plant_pins_power(plant_pins_t *pins, bool on, double now);
void plant_pins_cut(plant_pins_t *pins, int pin, bool cut, double now);

/* Let the brake follow its coil if due; true if it has. */
bool plant_pins_follow(plant_pins_t *pins, double now);

/* Coulomb friction of the shaft, the closed brake included [N m]. */
static inline double plant_pins_friction(const plant_pins_t *pins)
{
    return pins->friction + (pins->holds ? pins->torque : 0.0);
}

#endif

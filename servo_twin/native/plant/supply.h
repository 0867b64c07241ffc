/* supply.h - the DC bus seen at every edge: source, capacitor, brake resistor.
 *
 *   C du/dt = i_source - u / R_brake - i_load,   i_source = max(0, (u_source - u) / R)
 * The source is a rectifier: what braking motors return stays in the capacitor. Exact while the load is constant, the
 * moment included in which the source joins in or lets go, but for the parabola that this moment is taken from.
 */
#ifndef PLANT_SUPPLY_H
#define PLANT_SUPPLY_H

#include <stdbool.h>

#include "board.h"

typedef struct {
    double u_source;  /* open-circuit voltage [V] */
    double g_source;  /* [S] */
    double g_brake;   /* of the resistor [S]; 0: there is none */
    double c, inv_c;  /* [F], [1/F] */
    double per_rc;    /* [1/s] */
    bool braking;     /* the resistor is switched on */
    double u;         /* [V] */
    double e_source;  /* delivered by the source into the bus so far [J] */
    double e_brake;   /* burnt in the resistor so far [J] */
} supply_t;

/* The bus is charged to the voltage of the source. */
void supply_init(supply_t *supply, const plant_bus_t *config);

/* `h` seconds with the current `i_load` drawn. Returns the integral of the bus voltage [V s]. */
double supply_advance(supply_t *supply, double h, double i_load);

/* Charge taken out at once [A s]: a correction to loads that were given too low. */
static inline void supply_take(supply_t *supply, double charge) { supply->u -= charge * supply->inv_c; }

#endif

/* bus_braking.h - the DC bus while motors brake: the brake resistor, and how much braking current the bus takes (ST slide "Brake
 * resistor"). One per board, because both axes share the bus.
 *
 * The supply takes nothing back. In the order of rising voltage:
 *   off .. on     hysteresis of the resistor's switch
 *   start .. full the current that opposes the motion is folded back, at `full` to nothing
 *   over-voltage  fault; not while a resistor is fitted and able, see u_dc_max_braking
 */
#ifndef SERVO_DRIVE_BUS_BRAKING_H
#define SERVO_DRIVE_BUS_BRAKING_H

#include "math/frac.h"

typedef struct {
    bool fitted; /* default of the writable switch */
    frac16_t on, off; /* bus voltages */
    gain_t heating; /* u^2 -> part of the energy budget that the resistor burns in a slow tick */
    frac32_t cooling; /* part of the budget that leaves it in a slow tick */
    frac16_t start, full; /* bus voltages between which braking current is folded back */
    /* Over-voltage while the resistor is able: what the converter can just tell from its full scale. It is not visible
     * how far beyond that the bus is, and the capacitors' rating is not far away. */
    frac16_t u_dc_max_braking;
} bus_braking_config_t;

typedef struct {
    bool on;
    bool available; /* fitted, and not spent */
    bool exhausted; /* the budget is used up: off until half of it has cooled away */
    frac32_t heat; /* used part of the budget */
    frac16_t u_dc; /* bus voltage of the last tick */
    frac16_t regen_derating; /* part of the braking current that the bus takes now */
} bus_braking_t;

/* Resistor off and cold. */
void bus_braking_init(bus_braking_t *brake);

/* One slow tick at the bus voltage `u_dc`, with a resistor if one is `fitted`; `brake->on` is what its switch shall do. */
void bus_braking_step(bus_braking_t *brake, const bus_braking_config_t *config, bool fitted, frac16_t u_dc);

#endif

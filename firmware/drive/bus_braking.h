/* bus_braking.h - limits the DC-bus voltage during regenerative braking: brake resistor, derating of the braking
 * current (ST slide "Brake resistor"). One per board, because both axes share the bus.
 *
 * The supply cannot absorb energy. In order of increasing voltage:
 *   off .. on     hysteresis of the switch of the brake resistor
 *   start .. full the braking current is reduced linearly, to 0 at `full`
 *   over-voltage  fault; with an available resistor at u_dc_max_braking
 */
#ifndef SERVO_DRIVE_BUS_BRAKING_H
#define SERVO_DRIVE_BUS_BRAKING_H

#include "math/frac.h"

typedef struct {
    bool fitted; /* a brake resistor is fitted; default of param.brake */
    frac16_t on, off; /* thresholds of the switch, Q1.15 of full-scale bus voltage */
    gain_t heating; /* heat per slow tick / u^2, heat in parts of the energy budget */
    frac32_t cooling; /* heat lost per slow tick, Q1.31 of the energy budget */
    frac16_t start, full; /* range of the derating of the braking current, Q1.15 of full-scale bus voltage */
    /* Over-voltage threshold while the resistor is available, close to the rating of the capacitors: 98 % of the ADC
     * range, above which the measurement counts as saturated. Q1.15 of full-scale bus voltage. */
    frac16_t u_dc_max_braking;
} bus_braking_config_t;

typedef struct {
    bool on; /* commanded state of the switch */
    bool available; /* fitted, and energy budget not used up */
    bool exhausted; /* energy budget used up: off until the heat has decreased to half of the budget */
    frac32_t heat; /* used part of the energy budget, Q1.31 */
    frac16_t u_dc; /* bus voltage of the last tick, Q1.15 of full-scale bus voltage */
    frac16_t regen_derating; /* permitted part of the braking current, Q1.15 */
} bus_braking_t;

/* Initialise with the resistor off and cold. */
void bus_braking_init(bus_braking_t *braking);

/* One slow tick at the bus voltage `u_dc`; `fitted`: a resistor is fitted. Sets `braking->on`, the command of its
 * switch. */
void bus_braking_step(bus_braking_t *braking, const bus_braking_config_t *config, bool fitted, frac16_t u_dc);

#endif

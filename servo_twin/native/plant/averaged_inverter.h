/* averaged_inverter.h - three-phase inverter, averaged over the half cycle of the PWM in which the duties are constant.
 *
 * Driven leg, duty d, current i into the motor, bus u (dead time t_d, PWM frequency f):
 *   d_eff = limit(d - t_d f s(i), 0, 1)    while 0 < d < 1. In the dead time t_d the sign of the current selects the diode,
 *                                          so one edge of each period is t_d late or early: the mean error is t_d f u
 *                                          against the current. A pulse shorter than t_d is lost. A leg that does not
 *                                          switch (d = 0 or 1) has no dead time.
 *   v     = d_eff u - V_drop s(i)          switch and diode have the same drop; their resistance is in series with the
 *                                          phase and part of the motor's circuit (plant_motor_t.r)
 *   s(i)  = 1.5 x - 0.5 x^3, x = limit(i / i_w, -1, 1)   the sign, smoothed where the ripple takes both signs
 *   i_w   = u (t_d + m (1 - m) / (6 f)) / L,  m = d_max - d_min
 *           current that the bus builds up in the winding during a dead time (below it the phase clamps at zero) plus half the
 *           peak-to-peak ripple; at least the value for which one step is stable (i_floor).
 * The current drawn from the bus is sum(d_eff i).
 *
 * All switches open (freewheeling): a leg with current is clamped to a rail by its diode, a leg without current floats
 * between -V_drop and u + V_drop. Over one step of length h the currents change by h L^-1 (C v + ...), so the three
 * leg voltages solve a box-constrained complementarity problem: at the lower limit i >= 0, at the upper one i <= 0,
 * between them i = 0. This includes conduction when the back-EMF exceeds the bus, and currents never cross zero.
 *
 * Broken wires: an open phase carries no current, at any voltage; a phase shorted to bus minus stays at 0 V; two phases
 * shorted to each other share one terminal. The same solver applies, with other limits and terminals.
 */
#ifndef PLANT_AVERAGED_INVERTER_H
#define PLANT_AVERAGED_INVERTER_H

#include <stdbool.h>

#include "board.h"
#include "plant/motor.h"

#define PLANT_NO_SHORT (-2) /* value of short_from */
#define PLANT_BUS_MINUS (-1) /* value of short_to */

typedef struct {
    /* parameters */
    double dead_part; /* t_d f [1] */
    double v_drop; /* [V] */
    double r_on; /* [ohm] */
    double band_dead, band_ripple; /* i_w = u (band_dead + band_ripple m (1 - m)) [A/V] */
    double floor_dead, floor_drop; /* i_floor = u floor_dead + floor_drop [A/V], [A] */
    /* state */
    bool on; /* the switches follow the duties */
    bool unplugged; /* motor cable */
    bool has_fault; /* a phase is open or shorted */
    bool open[3]; /* the wire of the phase is broken */
    int short_from, short_to; /* shorted phase, and the other one or PLANT_BUS_MINUS; PLANT_NO_SHORT: none */
    double duty[3]; /* 0..1 [1] */
    double dead_leg[3]; /* t_d f of the legs that switch, 0 of the others [1] */
    double inv_i_w; /* 1 / i_w [1/A] */
    /* of the last step */
    double leg[3]; /* leg voltage above the negative rail, without the resistive drop [V] */
    double share[3]; /* d_eff: share of each phase current drawn from the bus, 0..1 [1] */
    double heat; /* loss in switches and diodes since it was last set to 0 [J] */
} averaged_inverter_t;

/* `pwm_frequency` [Hz]; `step` is the longest step taken [s]. */
void averaged_inverter_init(averaged_inverter_t *inverter, const plant_axis_t *config, double pwm_frequency,
                            double step);

/* New parameters; the state is kept. */
void averaged_inverter_change(averaged_inverter_t *inverter, const plant_axis_t *config, double pwm_frequency,
                              double step);

/* Connect the motor cable, or disconnect it: the currents become zero at once. */
void averaged_inverter_plug(averaged_inverter_t *inverter, plant_motor_t *motor, bool plugged);

/* Open the wire of a phase, so that its current becomes zero at once, or close it. */
void averaged_inverter_open(averaged_inverter_t *inverter, plant_motor_t *motor, int phase, bool open);

/* Short a phase to another phase or to PLANT_BUS_MINUS; phase PLANT_NO_SHORT: remove the short. */
void averaged_inverter_short(averaged_inverter_t *inverter, int phase, int to);

/* True while the switches feed the short, whose current exceeds the comparator's threshold within a microsecond. */
bool averaged_inverter_shorted(const averaged_inverter_t *inverter);

/* Load duties (0..1) at the beginning of a half cycle, at the bus voltage `u_dc` [V]. */
void averaged_inverter_load(averaged_inverter_t *inverter, const double duty[3], double u_dc);

/* One step of at most `dt` [s] of inverter and motor at bus voltage `u_dc`; returns the length of the step [s] and
 * adds the charge drawn from the bus to *charge [A s]. */
double averaged_inverter_step(averaged_inverter_t *inverter, plant_motor_t *motor, double u_dc, double dt,
                              double *charge);

/* Voltages of the phases against the midpoint of the bus at the end of a step [V]. */
void averaged_inverter_voltages(const averaged_inverter_t *inverter, const plant_motor_t *motor, double u_dc,
                                double voltage[3]);

/* The lower half of a leg conducts at a centre of the PWM period unless the upper switch is on there. */
static inline bool averaged_inverter_low_conducts(const averaged_inverter_t *inverter, int phase, bool low_side_centre)
{
    const double share = inverter->share[phase];
    return low_side_centre ? share < 1.0 : share <= 0.0;
}

/* Current in the shunt of a phase at the centre of the low-side (or else the high-side) time [A]: that of the lower switch or
 * diode. The general version is for open switches, broken wires and short circuits. */
double averaged_inverter_general_shunt(const averaged_inverter_t *inverter, const plant_motor_t *motor, int phase,
                                       bool low_side_centre);
static inline double averaged_inverter_shunt(const averaged_inverter_t *inverter, const plant_motor_t *motor, int phase,
                                             bool low_side_centre)
{
    if (!inverter->on || inverter->has_fault) {
        return averaged_inverter_general_shunt(inverter, motor, phase, low_side_centre);
    }
    return averaged_inverter_low_conducts(inverter, phase, low_side_centre) ? motor->phase[phase] : 0.0;
}

#endif

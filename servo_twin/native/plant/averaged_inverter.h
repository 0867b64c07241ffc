/* inverter.h - three half bridges, averaged over the half cycle in which the duties are constant.
 *
 * Driven leg, duty d, current i into the motor, bus u (dead time t_d, PWM frequency f):
 *   d_eff = limit(d - t_d f s(i), 0, 1)    while 0 < d < 1: with both switches open during t_d the current chooses the
 *                                          diode, so one edge of each period comes t_d late or early; the mean error is
 *                                          t_d f u against the current. A pulse shorter than t_d is lost. A leg that
 *                                          never switches (d = 0 or 1) has no dead time.
 *   v     = d_eff u - V_drop s(i)          switch and diode drop the same; their resistance is part of the motor's
 *                                          circuit (plant_motor_t.r), being in series with the phase whatever conducts
 *   s(i)  = 1.5 x - 0.5 x^3, x = limit(i / i_w, -1, 1)   the sign, softened where the edges meet both signs
 *   i_w   = u (t_d + m (1 - m) / (6 f)) / L,  m = d_max - d_min
 *           current that the bus builds up in the winding during a dead time (below it the phase clamps at zero) plus
 *           half the peak-to-peak ripple; never below what one step can follow (i_floor).
 * The bus delivers sum(d_eff i).
 *
 * All switches open: a leg with current is clamped to the rail that its diode leads to, a leg without one floats
 * between -V_drop and u + V_drop. Over one step of length h the currents change by h L^-1 (C v + ...), so the three
 * leg voltages solve a box-constrained complementarity problem: at the lower limit i >= 0, at the upper one i <= 0,
 * between them i = 0. That includes conduction when the back-EMF exceeds the bus, and never overshoots zero.
 *
 * Broken wires: a phase that is open carries no current, whatever that takes; one that touches bus minus stays there; two
 * that touch each other share one terminal. The same solver, with other limits and terminals.
 */
#ifndef PLANT_AVERAGED_INVERTER_H
#define PLANT_AVERAGED_INVERTER_H

#include <stdbool.h>

#include "board.h"
#include "plant/motor.h"

#define PLANT_NO_SHORT (-2)
#define PLANT_BUS_MINUS (-1)

typedef struct {
    /* parameters */
    double dead;                    /* t_d f */
    double v_drop;                  /* [V] */
    double r_on;                    /* [ohm] */
    double band_dead, band_ripple;  /* i_w = u (band_dead + band_ripple m (1 - m)) [A/V] */
    double floor_dead, floor_drop;  /* i_floor = u floor_dead + floor_drop [A/V], [A] */
    /* state */
    bool on;                        /* the switches follow the duties */
    bool unplugged;                 /* the motor's cable is off */
    bool broken;                    /* one of the following is the case */
    bool open[3];                   /* the wire of the phase is broken */
    int short_from,
        short_to; /* phases that touch, or a phase and PLANT_BUS_MINUS; PLANT_NO_SHORT if there is no short */
    double duty[3];
    double dead_leg[3]; /* t_d f of the legs that switch */
    double inv_i_w; /* [1/A] */
    /* of the last step */
    double leg[3]; /* leg voltage above the negative rail, without the resistive drop [V] */
    double share[3]; /* part of each phase current that the bus delivers, 0..1 */
    double heat; /* burnt in switches and diodes since it was taken last [J] */
} averaged_inverter_t;

/* `step` is the longest step taken [s]. */
void averaged_inverter_init(averaged_inverter_t *inverter, const plant_axis_t *config, double pwm_frequency,
                            double step);

/* Other parameters from now on. */
void averaged_inverter_change(averaged_inverter_t *inverter, const plant_axis_t *config, double pwm_frequency,
                              double step);

/* Plug in the motor's cable, or pull it: the currents are gone at once. */
void averaged_inverter_plug(averaged_inverter_t *inverter, plant_motor_t *motor, bool plugged);

/* Break the wire of a phase, or mend it: its current is gone at once. */
void averaged_inverter_open(averaged_inverter_t *inverter, plant_motor_t *motor, int phase, bool open);

/* A phase touches another, or bus minus; with PLANT_NO_SHORT there is no short any more. */
void averaged_inverter_short(averaged_inverter_t *inverter, int phase, int to);

/* True while the switches feed the short: its current rises within a microsecond beyond what the hardware allows. */
bool averaged_inverter_shorted(const averaged_inverter_t *inverter);

/* New duties (0..1) at the beginning of a half cycle. */
void averaged_inverter_load(averaged_inverter_t *inverter, const double duty[3], double u_dc);

/* One step of at most `dt` [s] of inverter and motor at bus voltage `u_dc`; returns the time that has passed and adds
 * the charge drawn from the bus to `charge` [A s]. */
double averaged_inverter_step(averaged_inverter_t *inverter, plant_motor_t *motor, double u_dc, double dt,
                              double *charge);

/* The phases' voltages against the midpoint of the bus at the end of a step [V]. */
void averaged_inverter_voltages(const averaged_inverter_t *inverter, const plant_motor_t *motor, double u_dc,
                                double voltage[3]);

/* The switch of the other side takes the current away from the low one whenever it is on at all around a centre. */
static inline bool averaged_inverter_low_conducts(const averaged_inverter_t *inverter, int phase, bool low_side_centre)
{
    const double share = inverter->share[phase];
    return low_side_centre ? share < 1.0 : share <= 0.0;
}

/* Current in the shunt of a phase at the centre of the low-side (or else the high-side) time: what the low switch or
 * its diode carries at that moment. The rare one is for switches that are open and for broken wires. */
double averaged_inverter_general_shunt(const averaged_inverter_t *inverter, const plant_motor_t *motor, int phase,
                                       bool low_side_centre);
static inline double averaged_inverter_shunt(const averaged_inverter_t *inverter, const plant_motor_t *motor, int phase,
                                             bool low_side_centre)
{
    if (!inverter->on || inverter->broken) {
        return averaged_inverter_general_shunt(inverter, motor, phase, low_side_centre);
    }
    return averaged_inverter_low_conducts(inverter, phase, low_side_centre) ? motor->phase[phase] : 0.0;
}

#endif

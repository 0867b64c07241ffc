/* observation.h - measurements and actions of the drive, input of the monitors.
 *
 * The drive fills it in before it calls a monitor, once per slow tick: what is electrical in the period of the watches,
 * the shaft after the controllers.
 */
#ifndef SERVO_DIAGNOSIS_OBSERVATION_H
#define SERVO_DIAGNOSIS_OBSERVATION_H

#include "control/pi.h"
#include "control/transforms.h"

#define OBSERVED_PHASES 3

/* Nominal values of motor and inverter. */
typedef struct {
    frac16_t silent;          /* less is no current */
    frac16_t direction_min;   /* largest phase current from which on the directions of silence are noted */
    gain_t resistance;        /* full-scale current over full-scale voltage */
    gain_t inductance;        /* the same for a current that changes by that within a slow tick */
    frac16_t emf_floor;       /* voltage that switches and dead time leave unexplained */
    int32_t turn_per_voltage; /* of a rotor within a slow tick, for its back-EMF at full scale, 2^16 is a turn */
} winding_config_t;

/* A converter's code at the centre of the high side, where its shunt carries nothing. */
typedef struct {
    uint16_t phase; /* 0, 1, 2: A, B, C */
    uint16_t code; /* ADC code, 12 bits */
    uint16_t zero; /* code of zero current */
    bool valid; /* the high side conducts long enough */
} idle_sample_t;

#define IDLE_SAMPLES 2 /* per slow tick */

typedef struct {
    /* what the axis does */
    uint16_t state; /* state_t, substate_t */
    uint16_t substate; /* substate_t */
    bool switching; /* the high sides conduct in turn; open switches leave the current of a turning shaft in diodes */
    bool controlled; /* a current controller runs, with its d axis at `d_axis_angle` .. */
    bool spins; /* .. and follows set-points */
    bool shorted; /* the windings are shorted because the shaft seems to rest */
    bool sensorless;
    uint16_t features; /* FEATURE_ bits */

    /* measurements */
    uint16_t temperature; /* code of the heat sink's sensor */
    frac16_t u_dc; /* of this period */
    frac16_t theta_e; /* Q1.15 of pi, electrical */
    int32_t position; /* counts */
    frac32_t speed; /* Q1.31 of full-scale speed, mechanical */

    /* currents and voltages of the last period, in the coordinates of `d_axis_angle` */
    frac16_t d_axis_angle; /* of the current controller, Q1.15 of pi, electrical, stator reference frame */
    dq_t current;     /* Q1.15 of full-scale current */
    dq_t current_ref; /* its set-point */
    dq_t voltage;     /* Q1.15 of full-scale voltage */
    pi_sum_t integrator_d; /* integral parts of the current controllers */
    pi_sum_t integrator_q; /* the same for q */
    frac16_t current_limit; /* longest current vector, Q1.15 of full-scale current */
    frac16_t omega_e; /* electrical speed, Q1.15 of full-scale speed x pole pairs */
    frac16_t emf; /* that belongs to this speed */
    int32_t current_magnitude; /* length of `current`, and the resistance's voltage for it */
    int32_t drop; /* resistance x current, Q1.15 of full-scale voltage */
    int32_t current_change; /* length of its change since the last slow tick */

    /* what one monitor has to tell the next */
    uint16_t ticks_without_movement; /* slow ticks since the count has moved by more than two */
    bool stop_unconfirmed; /* it has stopped at once, and whether the shaft has is not known yet */
    uint16_t conducting_phases; /* phases that carry current, a bit each */
} observation_t;

/* The spinning shaft, after the controllers. */
typedef struct {
    uint16_t features; /* FEATURE_ bits */
    frac32_t speed; /* Q1.31 of full-scale speed, mechanical */
    frac32_t speed_limit; /* the same */
    frac32_t over_speed_max; /* the same; a larger speed is a fault */
    int32_t following_error; /* counts */
    int32_t following_error_max; /* counts; a larger error is a fault */
    bool decelerated_at_limit; /* by the largest current, all of which the bus takes */
    bool no_movement_at_limit; /* at the largest current */
} shaft_observation_t;

#endif

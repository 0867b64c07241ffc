/* observation.h - input of the monitors: measurements and state of the drive, once per slow tick.
 *
 * drive/monitors.c fills observation_t before the monitors, in the PWM period of the monitors; drive/run_states.c fills
 * shaft_observation_t after the controllers.
 */
#ifndef SERVO_DIAGNOSIS_OBSERVATION_H
#define SERVO_DIAGNOSIS_OBSERVATION_H

#include "control/pi.h"
#include "control/transforms.h"

#define OBSERVED_PHASES 3

/* Thresholds and nominal values of motor and inverter. */
typedef struct {
    frac16_t current_min; /* smaller phase currents count as zero, Q1.15 of full-scale current */
    frac16_t direction_current_min; /* largest phase current above which octants without current are recorded */
    gain_t resistance; /* voltage / current, of full scales */
    gain_t inductance; /* voltage / change of the current per slow tick, of full scales */
    frac16_t emf_floor; /* voltage error by switches and dead time, Q1.15 of full-scale voltage */
    int32_t rotation_per_voltage; /* rotation per slow tick / back-EMF, 2^16 is one turn, back-EMF of full scale */
} winding_config_t;

/* ADC code sampled at the centre of the high side, where the shunt carries no current. */
typedef struct {
    uint16_t phase; /* 0, 1, 2: A, B, C */
    uint16_t code; /* ADC code, 12 bits */
    uint16_t zero; /* offset: ADC code of zero current */
    bool valid; /* the high side conducts long enough */
} idle_sample_t;

#define IDLE_SAMPLES 2 /* per slow tick */

typedef struct {
    /* state of the axis */
    uint16_t state; /* state_t */
    uint16_t substate; /* substate_t */
    bool switching; /* the switches operate; with open switches the current of a turning shaft flows in the diodes */
    bool controlled; /* current control with the d axis at `d_axis_angle` */
    bool spins; /* current control in SPIN, follows set-points */
    bool shorted; /* READY: windings shorted, because the shaft seems to be at rest */
    bool sensorless; /* feedback is the observer */
    uint32_t features; /* FEATURE_ bits */

    /* measurements */
    uint16_t temperature; /* ADC code of the heat sink sensor */
    frac16_t u_dc; /* bus voltage of this period, Q1.15 of full-scale bus voltage */
    frac16_t theta_e; /* Q1.15 of pi, electrical */
    int32_t count; /* encoder counts */
    uint16_t abrupt_counts; /* encoder counts per slow tick: a slower shaft cannot drive a current that causes a trip */
    frac32_t speed; /* Q1.31 of full-scale speed, mechanical */

    /* currents and voltages of the previous period, in the frame of `d_axis_angle` */
    frac16_t d_axis_angle; /* d axis of the current controller in the stator frame, Q1.15 of pi, electrical */
    dq_t current; /* Q1.15 of full-scale current */
    dq_t current_ref; /* current set-point, Q1.15 of full-scale current */
    dq_t voltage; /* Q1.15 of full-scale voltage */
    pi_sum_t integrator_d; /* integrator of the d current controller, 55 fraction bits */
    pi_sum_t integrator_q; /* integrator of the q current controller, 55 fraction bits */
    frac16_t current_limit; /* largest i_q, Q1.15 of full-scale current */
    frac16_t omega_e; /* electrical speed, Q1.15 of full-scale speed x pole pairs */
    frac16_t emf; /* expected back-EMF at this speed, Q1.15 of full-scale voltage */
    int32_t current_magnitude; /* length of `current`, Q1.15 of full-scale current */
    int32_t drop; /* resistance x current, Q1.15 of full-scale voltage */
    int32_t current_change; /* length of the change of `current` since the last slow tick, Q1.15 */

    /* results of one monitor that other monitors use */
    uint16_t ticks_without_movement; /* slow ticks since the count moved by more than two */
    bool stop_unconfirmed; /* the count stopped abruptly; it is not confirmed yet whether the shaft has stopped */
    uint16_t conducting_phases; /* phases that carry current, one bit each */
} observation_t;

/* Shaft in SPIN, after the controllers. */
typedef struct {
    uint32_t features; /* FEATURE_ bits */
    frac32_t speed; /* Q1.31 of full-scale speed, mechanical */
    frac32_t speed_limit; /* Q1.31 of full-scale speed */
    frac32_t over_speed_max; /* Q1.31 of full-scale speed; a higher speed is a fault */
    int32_t following_error; /* counts */
    int32_t following_error_max; /* counts; a larger error is a fault */
    bool decelerated_at_limit; /* decelerated by the full current, not reduced by bus or winding */
    bool no_movement_at_limit; /* no movement at full current */
} shaft_observation_t;

#endif

/* axis_config.h - configuration of one axis and of the board, in fixed-point numbers.
 *
 * tune.py computes the values from servo.toml (servo_config_gen.c): gains from bandwidths and motor data, limits from
 * SI units. The firmware uses no floating point.
 */
#ifndef SERVO_CONFIG_AXIS_CONFIG_H
#define SERVO_CONFIG_AXIS_CONFIG_H

#include "comm/access.h"
#include "comm/sha1.h"
#include "config/contract_gen.h"
#include "control/back_emf_observer.h"
#include "control/current_loop.h"
#include "control/field_weakening.h"
#include "control/friction.h"
#include "control/pll.h"
#include "control/torque_ripple.h"
#include "diagnosis/heat_sink_monitor.h"
#include "diagnosis/observation.h"
#include "diagnosis/shaft_monitor.h"
#include "diagnosis/winding_model.h"
#include "drive/bus_braking.h"
#include "drive/home_data.h"
#include "drive/inputs_data.h"
#include "drive/sensorless_startup_data.h"
#include "drive/stop_data.h"
#include "hal/hal.h"
#include "sensing/emf_check.h"
#include "sensing/encoder.h"
#include "sensing/mt_speed.h"
#include "sensing/rotor_search.h"
#include "sensing/speed_observer.h"
#include "sensing/speed_reliability.h"

typedef struct {
    current_loop_config_t current_loop;
    encoder_config_t encoder;
    mt_speed_config_t mt_speed;
    speed_observer_config_t speed_observer;
    rotor_search_config_t rotor_search;
    back_emf_observer_config_t observer;
    pll_config_t pll;
    speed_reliability_config_t reliability;
    emf_check_config_t emf_check;
    startup_config_t startup;
    uint16_t feedback; /* feedback_kind_t, default of param.feedback */

    pi_gains_t speed; /* speed controller with encoder: current / speed, of full scales */
    pi_gains_t observed_speed; /* speed controller with the back-EMF observer: current / speed, of full scales */
    int32_t position_gain; /* K_v (DRM E44): speed (Q1.31 of full scale) / count */
    uint16_t path_omega_n_ts; /* omega_n Ts of E40, 16 fraction bits */
    int32_t path_step_per_speed; /* counts per slow tick at full-scale speed, 16 fraction bits */
    int32_t speed_per_path_step; /* 1 / path_step_per_speed, 31 fraction bits */
    friction_config_t friction;
    torque_ripple_config_t torque_ripple;
    int32_t acceleration_forward; /* J / (Kt Ts): current / change of the speed per slow tick, 16 fraction bits */

    frac16_t torque_constant; /* 3/2 p psi_m, Q1.15 of 1 N m/A */
    frac16_t i_q_limit; /* default of param.i_q_limit, Q1.15 of full-scale current */
    frac32_t speed_limit; /* default of param.speed_limit, Q1.31 of full-scale speed */
    frac32_t acceleration_limit; /* default of param.acceleration_limit, Q1.31 of full-scale speed per slow tick */

    uint32_t features; /* FEATURE_ bits enabled after reset */
    int32_t position_limit; /* default of both soft limits, counts */
    int32_t following_error; /* default of param.following_error, counts */
    frac32_t over_speed; /* default of param.over_speed, Q1.31 of full-scale speed */

    frac16_t u_dc_nominal; /* bus voltage while the ripple compensation is off, Q1.15 of full-scale bus voltage */
    frac16_t u_dc_max; /* over-voltage threshold, Q1.15 of full-scale bus voltage */
    frac16_t u_dc_min; /* under-voltage threshold, Q1.15 of full-scale bus voltage */
    uint16_t offset_tolerance; /* largest offset of a current amplifier from mid-scale, ADC codes */
    frac16_t offset_duty_min; /* smallest duty for a valid offset sample, part of the PWM period */

    winding_config_t winding;
    heat_sink_monitor_config_t heat;
    winding_model_config_t winding_model;
    shaft_monitor_config_t shaft;

    uint16_t settle_ticks; /* settling time of the bus filter in INIT, slow ticks */
    uint16_t rest_ticks_max; /* longest wait of an enabled axis for standstill, slow ticks */
    uint16_t search_ticks_max; /* time-out of the rotor search, slow ticks */
    frac32_t stop_speed; /* speed below which a stop ends in position hold or coast, Q1.31 of full-scale speed */
    uint16_t stop_ticks_max; /* time-out after the end of the ramp, then the outputs are switched off, slow ticks */

    stop_config_t stop;
    /* Highest speed at which the copper losses at full current exceed the braking power, Q1.31 of full-scale speed. */
    frac32_t regeneration_speed;
    /* Largest -i_d during the derating of the braking current, for additional losses, Q1.15 of full-scale current. */
    frac16_t copper_current;
    field_weakening_config_t field_weakening;
    home_config_t home;
    pins_config_t pins;
} axis_config_t;

typedef struct {
    axis_config_t axis[HAL_AXES];
    bus_braking_config_t bus_braking;
    uint16_t host_timeout; /* default of param.host_timeout, slow ticks */
    uint16_t command_timeout; /* default of param.command_timeout, slow ticks */
    uint8_t password[ACCESS_LEVELS]
                    [SHA1_SIZE]; /* SHA-1 of the password per level, first ACCESS_VIEW; zeros: no password */
} servo_config_t;

#endif

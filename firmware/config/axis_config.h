/* axis_config.h - the controller's nominal values of one axis and of the board, as integers.
 *
 * The numbers come from servo.toml through tune.py (servo_config_gen.c): gains from bandwidths and motor data, limits
 * from volts and amperes. The core never sees a floating-point number.
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
    uint16_t feedback; /* default of the writable source: feedback_kind_t */

    pi_gains_t speed;           /* speed fraction -> current fraction */
    pi_gains_t observed_speed;  /* the same with the speed of the observer */
    int32_t position_gain;      /* speed fraction (31 bits) per count: K_v (DRM E44) */
    uint16_t path_omega_n_ts;   /* omega_n Ts of E40, 16 fraction bits */
    int32_t path_step_per_speed; /* counts per slow tick at full-scale speed, 16 fraction bits */
    int32_t speed_per_path_step; /* its reciprocal, 31 fraction bits */
    friction_config_t friction;
    int32_t acceleration_forward; /* speed fraction per slow tick -> current fraction, 16 fraction bits: J / (Kt Ts) */

    frac16_t torque_constant; /* 3/2 p psi_m over 1 N m/A */
    frac16_t i_q_limit; /* default of the writable limit */
    frac32_t speed_limit; /* default of the writable limit */
    frac32_t acceleration_limit; /* default of the writable limit: speed per slow tick */

    uint16_t features; /* FEATURE_ bits that are on after reset */
    int32_t position_limit; /* default of both writable soft limits, counts */
    int32_t following_error; /* default of the writable bound, counts */
    frac32_t over_speed; /* default of the writable bound */

    frac16_t u_dc_nominal; /* assumed while the ripple compensation is off */
    frac16_t u_dc_max; /* over-voltage */
    frac16_t u_dc_min; /* under-voltage */
    uint16_t offset_tolerance; /* ADC codes that an amplifier offset may lie off mid-scale */
    frac16_t offset_duty_min; /* shortest high side, part of a period, during which an offset sample is true */

    winding_config_t winding;
    heat_sink_monitor_config_t heat;
    winding_model_config_t winding_model;
    shaft_monitor_config_t shaft;

    uint16_t settle_ticks; /* slow ticks in INIT until the bus filter has settled */
    uint16_t rest_ticks_max; /* slow ticks that an enabled axis waits for its shaft to rest */
    uint16_t search_ticks_max; /* slow ticks that the rotor search may take */
    frac32_t stop_speed; /* below it a stop is over: hold, or coast */
    uint16_t stop_ticks_max; /* slow ticks after the ramp's end until the outputs go off at any speed */

    stop_config_t stop;
    frac32_t regeneration_speed; /* up to it the full current burns in the winding all that braking returns */
    /* i_d at most against the flux while braking current is folded back: its losses brake too. */
    frac16_t copper_current;
    field_weakening_config_t field_weakening;
    home_config_t home;
    pins_config_t pins;
} axis_config_t;

typedef struct {
    axis_config_t axis[HAL_AXES];
    bus_braking_config_t brake;
    uint16_t host_timeout; /* defaults of the writable time-outs, slow ticks */
    uint16_t command_timeout; /* the same, for speed and torque set-points */
    uint8_t password[ACCESS_LEVELS][SHA1_SIZE]; /* SHA-1 by level, from ACCESS_VIEW on; zeros: no password */
} servo_config_t;

extern const servo_config_t servo_config;

#endif

/* blocks.h - the memory that host and board share: telemetry, commands, parameters (servo_msgs_py/variables.toml). */
#ifndef SERVO_APP_BLOCKS_H
#define SERVO_APP_BLOCKS_H

#include "diagnosis/fault_latch.h"
#include "hal/hal.h"
#include "math/frac.h"

typedef struct {
    int32_t position;     /* counts */
    int32_t position_ref; /* counts */
    frac32_t speed; /* Q1.31 of full-scale speed, mechanical */
    frac32_t speed_ref; /* the same */
    fault_set_t faults;
    frac16_t i_q; /* Q1.15 of full-scale current */
    frac16_t i_d; /* the same */
    frac16_t i_q_ref; /* the same */
    frac16_t u_d; /* Q1.15 of full-scale voltage */
    frac16_t u_q; /* the same */
    frac16_t theta_e; /* Q1.15 of pi, electrical */
    uint16_t state; /* state_t */
    uint16_t substate; /* substate_t */
    uint16_t limits; /* LIMIT_ bits */
    uint16_t first_fault; /* fault code, 0 for none */
    uint16_t points_waiting; /* timed points */
    uint16_t points_taken; /* the same, since reset, modulo 65536 */
    uint16_t points_late; /* the same */
    frac16_t winding_temperature; /* Q1.15 of 256 deg C */
    uint16_t home_state; /* home_state_t */
    uint16_t inputs; /* INPUT_ bits */
} axis_snapshot_t;

/* All of it from one slow tick. */
typedef struct {
    uint32_t tick; /* PWM periods since reset */
    uint32_t applied_tick; /* tick at which the last write took effect */
    uint16_t applied_count; /* writes that have taken effect, modulo 65536 */
    frac16_t u_dc; /* Q1.15 of the full-scale bus voltage, filtered */
    int16_t monitor[HAL_ANALOG_OUTS]; /* Q1.15 of the full scale of what each output shows */
    uint16_t late_loops;        /* since reset, modulo 65536 */
    uint16_t receiver_overruns; /* the same */
    uint16_t points_refused;    /* writes of them, the same */
    uint16_t point_refusal;     /* point_refusal_t of the last one */
    axis_snapshot_t axis[HAL_AXES];
} snapshot_t;

#define POINTS_TOGETHER 8 /* timed points that are written at once */
#define POINT_WORDS 4

/* Written by the host at any time; latched right before a slow tick. */
typedef struct {
    int32_t position[HAL_AXES]; /* counts */
    frac32_t speed[HAL_AXES]; /* Q1.31 of full-scale speed */
    int32_t home_position[HAL_AXES]; /* counts */
    uint32_t test_step[HAL_AXES];    /* test signal: swept_sine_t */
    uint32_t test_growth[HAL_AXES]; /* the same: growth */
    uint32_t test_calls[HAL_AXES]; /* the same: calls */
    frac16_t i_q[HAL_AXES]; /* Q1.15 of full-scale current */
    uint16_t mode[HAL_AXES]; /* control_mode_t */
    uint16_t enable[HAL_AXES]; /* 1: on, 0: stop */
    uint16_t quick_stop[HAL_AXES]; /* 1: stop */
    uint16_t clear_faults[HAL_AXES]; /* 1: clear */
    uint16_t home[HAL_AXES]; /* home_method_t */
    frac16_t test_amplitude[HAL_AXES]; /* Q1.15 of the full scale at the test point */
    uint16_t test_point[HAL_AXES]; /* test_point_t */
    int32_t points[POINTS_TOGETHER * POINT_WORDS]; /* app/points.c */
} command_block_t;

typedef struct {
    frac32_t speed_limit[HAL_AXES]; /* Q1.31 of full-scale speed */
    frac32_t acceleration_limit[HAL_AXES]; /* Q1.31 of full-scale speed, per slow tick */
    frac16_t i_q_limit[HAL_AXES]; /* Q1.15 of full-scale current */
    uint16_t features[HAL_AXES];        /* FEATURE_ bits */
    uint16_t feedback[HAL_AXES];        /* feedback_kind_t */
    uint16_t on_disable[HAL_AXES];      /* stop_category_t */
    uint16_t on_quick_stop[HAL_AXES];   /* stop_category_t */
    int32_t position_min[HAL_AXES];     /* counts */
    int32_t position_max[HAL_AXES];     /* counts */
    int32_t following_error[HAL_AXES];  /* counts */
    frac32_t over_speed[HAL_AXES]; /* Q1.31 of full-scale speed */
    fault_set_t faults_enabled[HAL_AXES];
    uint16_t monitor[HAL_ANALOG_OUTS];     /* monitor_t */
    uint16_t host_timeout; /* slow ticks */
    uint16_t command_timeout; /* slow ticks; 0: set-points do not expire */
    uint16_t brake;        /* 1: there is a resistor */
    uint16_t unused; /* the size is the same on every machine */
} parameter_block_t;

#define CONFIG_TOGETHER 22 /* members of a configuration block that are written at once */
#define CONFIG_AXIS 0      /* words of the window */
#define CONFIG_FIRST 1
#define CONFIG_COUNT 2
#define CONFIG_VALUES 3
#define CONFIG_HEADER 4 /* words: axis, layout, members, checksum */

/* Written by the host to send configuration blocks (app/config_blocks.h). */
typedef struct {
    int32_t window[CONFIG_VALUES + CONFIG_TOGETHER]; /* CONFIG_ words, then values of members */
    int32_t header[CONFIG_HEADER]; /* axis, layout, members, checksum */
    uint16_t take; /* axes, a bit each */
    uint16_t unused; /* what follows has the same address on every machine */
} config_request_t;

typedef struct {
    uint32_t layout; /* hash of the members' names and formats */
    uint32_t checksum[HAL_AXES]; /* of the blocks in force */
    uint32_t taken_tick; /* PWM periods since reset when a block was last taken */
    uint16_t taken_count; /* blocks taken since reset, modulo 65536 */
    uint16_t answers; /* writes answered since reset, modulo 65536 */
    uint16_t refusal; /* CONFIG_REFUSAL_ of the last write */
    uint16_t refused_member; /* number of the member that the last refusal is about */
} config_status_t;

#define STORAGE_COPIES 2
#define STORAGE_KIND 0 /* words of a request */
#define STORAGE_TOKEN 1

/* Written by the host to keep parameters and configuration in the data flash (app/storage.h). */
typedef struct {
    uint16_t request[2]; /* STORAGE_REQUEST_, and a number that the last request did not have */
} storage_request_t;

typedef struct {
    uint32_t sequence; /* of the newest set in the flash; 0: there is none */
    uint16_t state;    /* storage_state_t */
    uint16_t answered; /* token of the last request that has been dealt with */
    uint16_t refusal;  /* storage_refusal_t of the last request */
    uint16_t source;   /* storage_source_t: where the values at the last reset came from */
    uint16_t copy[STORAGE_COPIES]; /* stored_copy_t */
    uint16_t saves;    /* carried out since reset */
    uint16_t unused; /* what follows has the same address on every machine */
} storage_status_t;

/* Output of the observer; 0 where it does not run. The angle is that of the snapshot, the rest at most a slow tick older. */
typedef struct {
    frac32_t speed; /* Q1.31 of full-scale speed, mechanical */
    frac16_t theta_e; /* at the sampling instant, as the snapshot's */
    frac16_t emf; /* length, Q1.15 of full-scale voltage */
    uint16_t reliable; /* 1: the speed is reliable */
    uint16_t unused; /* what follows has the same address on every machine */
} axis_estimate_t;

typedef struct {
    axis_estimate_t axis[HAL_AXES];
} estimate_block_t;

/* Nominal values of the controller for the motors, for the host's conversions. */
typedef struct {
    frac16_t torque_constant[HAL_AXES]; /* Q1.15 of 1 N m/A */
    int32_t acceleration_current[HAL_AXES]; /* axis_config_t.acceleration_forward */
} nominal_block_t;

#endif

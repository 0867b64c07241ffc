/* blocks.h - memory shared with the host: telemetry and commands (servo_msgs_py/variables.toml). */
#ifndef SERVO_APP_BLOCKS_H
#define SERVO_APP_BLOCKS_H

#include "config/parameters_gen.h"
#include "diagnosis/fault_latch.h"
#include "hal/hal.h"
#include "math/frac.h"

typedef struct {
    int32_t position;     /* counts */
    int32_t position_ref; /* counts */
    frac32_t speed; /* Q1.31 of full-scale speed, mechanical */
    frac32_t speed_ref; /* speed set-point, Q1.31 of full-scale speed */
    fault_set_t faults; /* captured faults */
    frac16_t i_q; /* Q1.15 of full-scale current */
    frac16_t i_d; /* Q1.15 of full-scale current */
    frac16_t i_q_ref; /* Q1.15 of full-scale current */
    frac16_t u_d; /* Q1.15 of full-scale voltage */
    frac16_t u_q; /* Q1.15 of full-scale voltage */
    frac16_t theta_e; /* Q1.15 of pi, electrical */
    uint16_t state; /* state_t */
    uint16_t substate; /* substate_t */
    uint16_t limits; /* LIMIT_ bits */
    uint16_t first_fault; /* fault code; 0: none */
    uint16_t points_waiting; /* queued timed points */
    uint16_t points_taken; /* accepted timed points since reset, modulo 65536 */
    uint16_t points_late; /* late timed points since reset, modulo 65536 */
    frac16_t winding_temperature; /* Q1.15 of 256 deg C */
    uint16_t home_state; /* home_state_t */
    uint16_t inputs; /* INPUT_ bits */
    uint16_t oscillation; /* frequency of the last oscillation since the axis was enabled, Hz; 0: none */
    uint16_t unused; /* padding: equal addresses on all processors */
} axis_snapshot_t;

/* Telemetry; all values are of the same slow tick. */
typedef struct {
    uint32_t tick; /* PWM periods since reset */
    uint32_t applied_tick; /* tick at which the last write took effect */
    uint16_t applied_count; /* writes that have taken effect, modulo 65536 */
    frac16_t u_dc; /* Q1.15 of the full-scale bus voltage, filtered */
    int16_t monitor[HAL_ANALOG_OUTS]; /* monitor outputs, Q1.15 of the full scale of the selected variable */
    uint16_t late_loops; /* late or omitted loops since reset, modulo 65536 */
    uint16_t receiver_overruns; /* lost received bytes since reset, modulo 65536 */
    uint16_t points_refused; /* refused writes of timed points since reset, modulo 65536 */
    uint16_t point_refusal; /* point_refusal_t of the last refused write */
    axis_snapshot_t axis[HAL_AXES];
} snapshot_t;

#define POINTS_TOGETHER 8 /* largest number of timed points in one write */
#define POINT_WORDS 4

#define POINTS_MEASURING 2 /* the same during a measurement */

/* During a measurement most of the memory of the points keeps the parameters of its beginning (app/measurement.h). */
typedef union {
    int32_t points[POINTS_TOGETHER * POINT_WORDS]; /* timed points, format in app/points.c */
    struct {
        int32_t points[POINTS_MEASURING * POINT_WORDS];
        parameter_block_t parameter;
    } measuring;
} points_memory_t;

/* Written by the host at any time; latched before a slow tick. */
typedef struct {
    int32_t position[HAL_AXES]; /* counts */
    frac32_t speed[HAL_AXES]; /* Q1.31 of full-scale speed */
    int32_t home_position[HAL_AXES]; /* counts */
    uint32_t test_step[HAL_AXES]; /* test signal: swept_sine_t.step */
    uint32_t test_growth[HAL_AXES]; /* test signal: swept_sine_t.growth */
    uint32_t test_calls[HAL_AXES]; /* test signal: swept_sine_t.calls */
    frac16_t i_q[HAL_AXES]; /* Q1.15 of full-scale current */
    uint16_t mode[HAL_AXES]; /* control_mode_t */
    uint16_t enable[HAL_AXES]; /* 1: on, 0: stop */
    uint16_t quick_stop[HAL_AXES]; /* 1: stop */
    uint16_t clear_faults[HAL_AXES]; /* 1: clear */
    uint16_t home[HAL_AXES]; /* home_method_t */
    frac16_t test_amplitude[HAL_AXES]; /* Q1.15 of the full scale at the test point */
    uint16_t test_point[HAL_AXES]; /* test_point_t */
    points_memory_t memory;
} command_block_t;

#define CONFIG_TOGETHER 22 /* largest number of configuration members in one write */
#define CONFIG_AXIS 0      /* word index in the window: axis */
#define CONFIG_FIRST 1     /* word index: number of the first member */
#define CONFIG_COUNT 2     /* word index: number of members */
#define CONFIG_VALUES 3    /* word index: first value */

/* Written by the host to send configuration blocks (app/config_blocks.h). */
typedef struct {
    int32_t window[CONFIG_VALUES + CONFIG_TOGETHER]; /* words CONFIG_AXIS .. CONFIG_COUNT, then values of members;
                                                      * the checksum has the number AXIS_MEMBERS */
    uint16_t take; /* axes whose spare block is to be activated, one bit each */
    uint16_t unused; /* padding: equal addresses on all processors */
} config_request_t;

/* State of the configuration blocks (app/config_blocks.h). */
typedef struct {
    uint32_t layout; /* hash of names and formats of the members */
    uint32_t checksum[HAL_AXES]; /* checksums of the blocks in force */
    uint32_t taken_tick; /* PWM periods since reset at the last activation of a block */
    uint16_t answers; /* processed writes of config.take since reset, modulo 65536 */
    uint16_t refusal; /* CONFIG_REFUSAL_ of the last write */
    uint16_t refused_member; /* number of the member that caused the last refusal */
    uint16_t unused; /* padding: equal addresses on all processors */
} config_status_t;

#define STORAGE_COPIES 2
#define STORAGE_KIND 0 /* word index in a request: STORAGE_REQUEST_ */
#define STORAGE_TOKEN 1 /* word index in a request: token */

/* Written by the host to store parameters and configuration in the data flash (app/storage.h). */
typedef struct {
    uint16_t request[2]; /* STORAGE_REQUEST_, and a token other than that of the last request */
} storage_request_t;

/* State of the storage (app/storage.h). */
typedef struct {
    uint32_t sequence; /* sequence number of the newest set in the flash; 0: none */
    uint16_t state; /* storage_state_t */
    uint16_t answered; /* token of the last processed request */
    uint16_t refusal; /* storage_refusal_t of the last request */
    uint16_t source; /* storage_source_t: source of the values at the last reset */
    uint16_t copy[STORAGE_COPIES]; /* stored_copy_t */
    uint16_t saves; /* completed saves since reset */
    uint16_t unused; /* padding: equal addresses on all processors */
} storage_status_t;

/* Written by the host to begin and end a session (app/measurement.h). */
typedef struct {
    uint16_t axis; /* 0: end; number of an axis, from 1: begin */
    uint16_t unused; /* padding: equal addresses on all processors */
} measurement_request_t;

/* State of the session (app/measurement.h). */
typedef struct {
    uint16_t state; /* measurement_state_t */
    uint16_t ended; /* measurement_end_t: cause of the last end */
} measurement_status_t;

/* Output of the back-EMF observer; 0 while it is not running. The angle is of the tick of the snapshot, the other
 * values are at most one slow tick older. */
typedef struct {
    frac32_t speed; /* Q1.31 of full-scale speed, mechanical */
    frac16_t theta_e; /* angle at the sampling instant, Q1.15 of pi, electrical */
    frac16_t emf; /* amplitude of the back-EMF, Q1.15 of full-scale voltage */
    uint16_t reliable; /* 1: the speed is reliable */
    uint16_t unused; /* padding: equal addresses on all processors */
} axis_estimate_t;

typedef struct {
    axis_estimate_t axis[HAL_AXES];
} estimate_block_t;

/* Nominal values of the motors, for conversions by the host. */
typedef struct {
    frac16_t torque_constant[HAL_AXES]; /* Q1.15 of 1 N m/A */
    int32_t acceleration_current[HAL_AXES]; /* axis_config_t.acceleration_forward */
} nominal_block_t;

#endif

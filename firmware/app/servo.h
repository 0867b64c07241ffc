/* servo.h - application: two axes, schedule, communication with the host.
 *
 * The complete state of one board is in one servo_t, owned by the caller. A port calls the entry points at the instants
 * listed in hal/hal.h.
 */
#ifndef SERVO_APP_SERVO_H
#define SERVO_APP_SERVO_H

#include "app/analog_out.h"
#include "app/blocks.h"
#include "app/config_blocks.h"
#include "app/event_log.h"
#include "app/latch.h"
#include "app/measurement_data.h"
#include "app/storage.h"
#include "comm/freemaster.h"
#include "drive/axis.h"
#include "hal/hal.h"

/* PWM periods per slow loop: 0.5 ms (DRM 2.3.2). */
#define SERVO_SLOW_PERIODS AXIS_SLOW_PERIODS

/* Recorder numbers: one sample per PWM period, one sample per slow tick. */
#define SERVO_RECORDER_FAST 0
#define SERVO_RECORDER_SLOW 1

/* Sample memory of both recorders, bytes, a multiple of four. */
#ifndef SERVO_SAMPLES
#define SERVO_SAMPLES 7680
#endif

typedef struct servo {
    uint32_t catalogue_hash; /* hash of variables.toml */
    uint32_t boot_token; /* 0 after a reset; then the number that the first host has written, until the next reset */
    snapshot_t snapshot;
    command_block_t command;
    parameter_block_t parameter;
    fault_record_t record[HAL_AXES];
    nominal_block_t nominal;
    estimate_block_t estimate;
    config_request_t config;
    config_status_t config_status;
    storage_request_t storage_request;
    storage_status_t storage_status;
    measurement_request_t measurement_request;
    measurement_status_t measurement_status;

    hal_t *hal;
    axis_t axis[HAL_AXES];
    config_blocks_t config_blocks;
    storage_t storage;
    measurement_t measurement;
    board_parameters_t settings; /* parameters of the board in this slow tick */
    bus_braking_t bus_braking;
    bus_braking_config_t bus_braking_config; /* copy in RAM: interrupts must not read constants in the data flash */
    uint32_t tick; /* PWM periods since reset */
    bool m2_awaited; /* M1 has run, M2 has not */
    uint16_t lateness; /* count of late loops, with decay */
    uint16_t late_loops; /* late or omitted loops since reset, modulo 65536 */
    uint16_t hal_late_loops; /* hal_late_loops of the last slow tick */
    int16_t monitor[HAL_ANALOG_OUTS]; /* monitor outputs, Q1.15 of the full scale of the selected variable */
    bool monitoring; /* a variable is selected for a monitor output */
    uint32_t applied_tick; /* tick at which the last write took effect */
    uint16_t applied_count; /* writes that have taken effect, modulo 65536 */
    volatile bool locked; /* the server is copying: do not latch commands, do not publish a snapshot */
    latch_marks_t marks;
    uint16_t points_refused; /* refused writes of timed points since reset, modulo 65536 */
    uint16_t point_refusal; /* point_refusal_t of the last refused write */
    volatile uint16_t host_commands; /* commands and keep-alives received; written by the background loop only */
    uint16_t host_commands_seen; /* `host_commands` at the last supervision */
    uint16_t host_idle_ticks; /* slow ticks without a command or keep-alive */
    bool host_seen; /* a command was received since reset */
    volatile bool host_silent; /* no command or keep-alive within param.host_timeout */
    event_log_t event_log;
    freemaster_t freemaster;
    uint32_t samples[SERVO_SAMPLES / 4]; /* sample memory of both recorders */
} servo_t;

/* Initialise everything. The configuration is copied, except the hashes of the passwords. */
void servo_init(servo_t *servo, hal_t *hal, const servo_config_t *config);

/* Parts of servo_init: configuration, parameters and stored values; server, callbacks, passwords. */
void servo_restore(servo_t *servo, const servo_config_t *config);
void servo_host_init(servo_t *servo, const servo_config_t *config);

/* Interrupts: t1 and t3 of DRM F34, captured encoder edge, hardware over-current latch. */
void servo_m1_isr(servo_t *servo);
void servo_m2_isr(servo_t *servo);
void servo_edge_isr(servo_t *servo, uint16_t axis);
void servo_over_current_isr(servo_t *servo, uint16_t axis);

/* Background loop, below all interrupts. */
void servo_background(servo_t *servo);

/* Access for hosts without a serial line, as FreeMASTER READMEM and WRITEMEM; 0 or a FreeMASTER status code. Does
 * not restart the timeout of HOST_SILENT, which supervises the serial line. */
fm_status_t servo_read(servo_t *servo, uint32_t address, uint8_t *data, uint16_t size);
fm_status_t servo_write(servo_t *servo, uint32_t address, const uint8_t *data, uint16_t size);

#endif

/* servo.h - the application: two axes, the timing diagram, the host's view.
 *
 * All state of one board hangs off one servo_t that the caller owns. A port calls the entry points at the instants that
 * hal/hal.h names.
 */
#ifndef SERVO_APP_SERVO_H
#define SERVO_APP_SERVO_H

#include "app/analog_out.h"
#include "app/blocks.h"
#include "app/config_blocks.h"
#include "app/event_log.h"
#include "app/latch.h"
#include "app/storage.h"
#include "comm/freemaster.h"
#include "drive/axis.h"
#include "hal/hal.h"

/* PWM periods per slow loop: 0.5 ms (DRM 2.3.2). */
#define SERVO_SLOW_PERIODS AXIS_SLOW_PERIODS

/* Recorders: one sample per PWM period, and one per slow tick. */
#define SERVO_RECORDER_FAST 0
#define SERVO_RECORDER_SLOW 1

/* Bytes of the samples of one of them, a multiple of four. */
#ifndef SERVO_SAMPLES
#define SERVO_SAMPLES 7680
#endif

typedef struct servo {
    uint32_t catalogue_hash; /* hash of variables.toml */
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

    hal_t *hal;
    axis_t axis[HAL_AXES];
    config_blocks_t config_blocks;
    storage_t storage;
    board_settings_t settings;
    bus_braking_t bus_braking;
    bus_braking_config_t brake_config; /* a copy: no interrupt reads what may lie in the data flash */
    uint32_t tick; /* PWM periods since reset */
    bool m2_awaited;     /* M1 has run, M2 has not */
    uint16_t lateness;   /* of the loops, forgotten with time */
    uint16_t late_loops;     /* late or left out since reset, modulo 65536 */
    uint16_t hal_late_loops; /* of the last slow tick */
    int16_t monitor[HAL_ANALOG_OUTS]; /* what the monitor outputs show */
    bool monitoring;     /* a monitor output shows something */
    uint32_t applied_tick; /* tick at which the last write took effect */
    uint16_t applied_count; /* writes that have taken effect, modulo 65536 */
    volatile bool locked; /* the server is copying: neither latch commands nor publish a snapshot */
    latch_marks_t marks;
    uint16_t points_refused; /* writes of timed points since reset */
    uint16_t point_refusal;  /* point_refusal_t of the last one */
    volatile uint16_t host_commands; /* and keep-alives that came over the line; only the background writes it */
    uint16_t host_commands_seen;     /* by the last supervision */
    uint16_t host_silence;           /* slow ticks since then */
    bool host_seen;                  /* the line has carried a command at all */
    event_log_t event_log;
    freemaster_t freemaster;
    uint32_t samples[SERVO_SAMPLES / 4]; /* of both recorders, in words of 4 bytes */
} servo_t;

void servo_init(servo_t *servo, hal_t *hal);

/* Parts of it: parameters, and what the data flash keeps; for the host, server, its callbacks, passwords. */
void servo_restore(servo_t *servo);
void servo_host_init(servo_t *servo);

/* Interrupts: t1 and t3 of DRM F34, a latched encoder edge, the hardware over-current break. */
void servo_m1_isr(servo_t *servo);
void servo_m2_isr(servo_t *servo);
void servo_edge_isr(servo_t *servo, uint16_t axis);
void servo_over_current_isr(servo_t *servo, uint16_t axis);

/* Below all interrupts, again and again. */
void servo_background(servo_t *servo);

/* The host's view without a serial line: as FreeMASTER READMEM and WRITEMEM; 0 or a FreeMASTER status code. Such a write
 * is no sign of life of a host: HOST_SILENT watches the line. */
uint8_t servo_read(servo_t *servo, uint32_t address, uint8_t *data, uint16_t size);
uint8_t servo_write(servo_t *servo, uint32_t address, const uint8_t *data, uint16_t size);

#endif

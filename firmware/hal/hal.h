/* hal.h - hardware abstraction layer: ADC codes, duty cycles, timer counts, captures, bytes.
 *
 * One port per board implements these functions (MC56F84789 with registers, virtual board with a motor model). Each
 * function has the board as its first parameter, so that one process can contain many boards.
 *
 * A port calls these entry points of the application (app/servo.h) at the instants of DRM F34:
 *   servo_m1_isr      t1, after the three conversions of motor 1
 *   servo_m2_isr      t3, at the end of the scan
 *   servo_edge_isr    at the captured encoder B edge of an axis, if the interrupt is armed
 *   servo_over_current_isr   when an over-current has opened the switches of an axis; of both axes, one after the
 *                            other, if the board does not know which one it is
 *   servo_background  in an endless loop, below all interrupts
 */
#ifndef SERVO_HAL_H
#define SERVO_HAL_H

#include <stdbool.h>
#include <stdint.h>

#include "config/board_gen.h"

#define HAL_AXES 2

typedef struct hal hal_t; /* context of the port; opaque to the application */

/* The two phases whose shunts are sampled; the third current is their negative sum (DRM 2.3.2). A board with two shunts
 * has the pair BC only. */
typedef enum {
    PHASE_PAIR_AB = 0,
    PHASE_PAIR_BC = 1,
    PHASE_PAIR_CA = 2,
} phase_pair_t;

/* Pair that a board samples if `pair` is wanted. */
static inline phase_pair_t hal_pair(phase_pair_t pair) { return (BOARD_SHUNTS == 2UL) ? PHASE_PAIR_BC : pair; }

/* One parallel conversion: 12-bit right-aligned codes (0..4095) of the first and second phase of a pair. A positive
 * current into the motor raises the code above mid-scale. */
typedef struct {
    uint16_t first; /* code of the first phase of the pair */
    uint16_t second; /* code of the second phase of the pair */
} adc_pair_t;

/* Encoder counter and free-running time stamp, both captured at the same B edge. */
typedef struct {
    uint16_t count; /* encoder counts, 16 bits */
    uint16_t time; /* periods of BOARD_TIMER_CLOCK_HZ */
} edge_capture_t;

/* ---- analogue inputs ------------------------------------------------------------------------------------------ */

/* Select the phase pair of the next conversions of `axis`, for currents and offsets: a result of hal_pair(). */
void hal_adc_select(hal_t *hal, uint16_t axis, phase_pair_t pair);

/* Codes sampled at the low-side centre of `axis` (phase currents). */
adc_pair_t hal_adc_currents(hal_t *hal, uint16_t axis);

/* Codes sampled at the high-side centre of `axis` (amplifier offsets: no current in the shunts). */
adc_pair_t hal_adc_offsets(hal_t *hal, uint16_t axis);

/* Newest code of the bus divider (DRM E46). */
uint16_t hal_adc_bus(hal_t *hal);

/* Newest code of the temperature sensor on the heat sink of `axis`. */
uint16_t hal_adc_temperature(hal_t *hal, uint16_t axis);

/* ---- inverter -------------------------------------------------------------------------------------------------- */

/* High-side duties of the phases in Q1.15 (0..32767 is 0..100 %); loaded at the next half cycle of the axis. A board may
 * limit the duty of a phase with a shunt to a low side of BOARD_LOW_SIDE_NS. */
void hal_pwm_duty(hal_t *hal, uint16_t axis, int16_t duty_a, int16_t duty_b, int16_t duty_c);

/* on: the six switches of `axis` follow the duties; off: all switches open immediately. */
void hal_pwm_enable(hal_t *hal, uint16_t axis, bool on);

/* True while the over-current latch of `axis` holds its outputs off, or its gate drivers are not ready. */
bool hal_over_current_active(hal_t *hal, uint16_t axis);

/* Release the latch; it latches again at once if the current is still too high. */
void hal_over_current_clear(hal_t *hal, uint16_t axis);

/* ---- switches and holding brake ---------------------------------------------------------------------------------- */

/* Digital inputs of an axis, after polarity: 1 is active. Limit switches and enable input are closed in normal
 * operation, so a broken wire gives the safe state. */
#define HAL_INPUT_HOME UINT16_C(1) /* closed: the shaft is in the range of the home switch */
#define HAL_INPUT_LIMIT_MIN UINT16_C(2) /* open: the end of the travel is reached */
#define HAL_INPUT_LIMIT_MAX UINT16_C(4)
#define HAL_INPUT_ENABLE UINT16_C(8) /* closed without interruption since the last hal_enable_input */
uint16_t hal_inputs(hal_t *hal, uint16_t axis);

/* `used`: an open enable input of `axis` opens the six switches in hardware, or within 1 us, until the next call of this
 * function with a closed input. Must not be called in RUN. */
void hal_enable_input(hal_t *hal, uint16_t axis, bool used);

/* Coil of the holding brake of `axis`; without current, and in reset, the brake is closed. */
void hal_holding_brake(hal_t *hal, uint16_t axis, bool release);

/* ---- DC bus and monitor outputs --------------------------------------------------------------------------------- */

/* Switch of the brake resistor between bus voltage and ground. */
void hal_brake_resistor(hal_t *hal, bool on);

/* Two slow analogue outputs for an oscilloscope; 0: 0 V, 65535: full voltage. */
#define HAL_ANALOG_OUTS 2
void hal_analog_out(hal_t *hal, uint16_t channel, uint16_t value);

/* ---- encoder timers (DRM 2.4, F10) ---------------------------------------------------------------------------- */

/* Start the counter at 0; it reloads 0 after `period` counts in either direction, 400..32768. Not in RUN. */
void hal_encoder_start(hal_t *hal, uint16_t axis, uint16_t period);

/* Quadrature count: 0..period - 1 upwards, 0..1 - period (two's complement) downwards, reload 0. */
uint16_t hal_encoder_count(hal_t *hal, uint16_t axis);
void hal_encoder_preset(hal_t *hal, uint16_t axis, uint16_t count);

/* Number of emulated index pulses, counts upwards in both directions of rotation. */
uint16_t hal_index_count(hal_t *hal, uint16_t axis);

/* Arm the B-edge interrupt: the next B edge is captured, later ones are not. */
void hal_capture_arm(hal_t *hal, uint16_t axis);

/* If a B edge has been captured since arming: store it, disarm the interrupt and return true. A second call before the
 * next arming returns false. */
bool hal_capture_take(hal_t *hal, uint16_t axis, edge_capture_t *capture);

/* Time since the last captured B edge in periods of BOARD_TIMER_CLOCK_HZ; HAL_EDGE_AGE_OVERFLOW once 16 bits are not
 * enough. */
#define HAL_EDGE_AGE_OVERFLOW UINT32_C(0x10000)
uint32_t hal_edge_age(hal_t *hal, uint16_t axis);

/* ---- data flash ------------------------------------------------------------------------------------------------- */

/* Non-volatile memory: sectors of 32-bit words. An erase sets all bits of a sector to 1; then each word can be
 * programmed once. One command at a time. During a command, and after a power failure in it, the contents of the
 * sector or word are undefined; the data flash cannot be read during a command. */
#define HAL_FLASH_SECTORS BOARD_FLASH_SECTORS
#define HAL_FLASH_SECTOR_WORDS BOARD_FLASH_SECTOR_WORDS
#define HAL_FLASH_ERASED UINT32_C(0xFFFFFFFF) /* word of an erased sector */

typedef enum {
    HAL_FLASH_DONE,
    HAL_FLASH_BUSY,
    HAL_FLASH_FAILED,
} hal_flash_t;

/* False on a board without data flash; then the other functions must not be called. */
bool hal_flash_present(hal_t *hal);

uint32_t hal_flash_read(hal_t *hal, uint16_t word);

/* Begin a command. */
void hal_flash_erase(hal_t *hal, uint16_t sector);
void hal_flash_program(hal_t *hal, uint16_t word, uint32_t value);

/* Result of the last command. */
hal_flash_t hal_flash_result(hal_t *hal);

/* ---- serial line and watchdog ---------------------------------------------------------------------------------- */

/* Read one received byte; false if there is none. */
bool hal_serial_get(hal_t *hal, uint8_t *byte);

/* Send one byte; false if the transmitter is busy. */
bool hal_serial_put(hal_t *hal, uint8_t byte);

/* End of the fast loop of `axis`. A loop is late if its duties are set after the instant of their loading. */
void hal_duties_done(hal_t *hal, uint16_t axis);

/* Number of late loops since reset plus two per omitted pair of loops (M1 and M2), modulo 65536. A single omitted
 * loop is not counted here; the application detects it by the order of its entry points. */
uint16_t hal_late_loops(hal_t *hal);

/* Number of received bytes lost since reset, modulo 65536. */
uint16_t hal_receiver_overruns(hal_t *hal);

/* True if the last reset was caused by the watchdog. */
bool hal_reset_by_watchdog(hal_t *hal);

/* Service the watchdog; called once per slow tick, after both fast loops. */
void hal_watchdog_service(hal_t *hal);

#endif

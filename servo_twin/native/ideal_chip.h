/* ideal_chip.h - implementation of hal/hal.h without registers, directly on the averaged plant.
 *
 * Timing of one PWM period T = 62.5 us (DRM F34), k counts half cycles of T/2:
 *   k even   low-side centre of axis 1, high-side centre of axis 2: currents of 1, offsets of 2, bus; servo_m1_isr
 *   k odd    high-side centre of axis 1, low-side centre of axis 2: currents of 2, offsets of 1, bus; servo_m2_isr
 * Duties written in an interrupt are loaded at the next half cycle, so they take effect T/2 after their samples
 * and hold for one period. Conversions and software take no time. Comparators and captured edges are evaluated once per step
 * of the plant, a half cycle.
 */
#ifndef SERVO_TWIN_IDEAL_CHIP_H
#define SERVO_TWIN_IDEAL_CHIP_H

#include <stdbool.h>
#include <stdint.h>

#include "app/servo.h"
#include "flash.h"
#include "hal/hal.h"
#include "plant/plant.h"
#include "uart.h"

typedef struct {
    double duty[3]; /* last written duties [1] */
    bool written; /* the duties are not loaded yet */
    bool enabled; /* outputs on */
    bool tripped; /* over-current latch */
    bool enable_used; /* the enable input is fitted */
    bool enable_open; /* latch of the enable input */
    phase_pair_t pair;
    adc_pair_t currents;
    plant_samples_t offsets;
} chip_axis_t;

struct hal {
    servo_t *servo;
    const servo_config_t *servo_config;
    plant_t plant;
    uart_t uart;
    flash_t flash;
    chip_axis_t axis[HAL_AXES];
    uint16_t bus_code; /* ADC code of the bus voltage */
    uint64_t now_ns; /* present time of the software [ns] */
    uint64_t grid_ns; /* end of the next step of the plant [ns] */
    int sampled; /* axis with its low-side centre at grid_ns */
    uint32_t scans; /* number of M2 interrupts */
    uint32_t breaks; /* trips of an over-current latch */
    uint16_t monitor[HAL_ANALOG_OUTS]; /* analogue outputs */
    uint16_t late; /* hal_late_loops() */
    unsigned left_out; /* consecutive omitted loops */
    uint64_t stalled_ns; /* end of a stall of the core [ns] */
    uint64_t served_ns; /* last service of the watchdog [ns] */
    bool watchdog_reset; /* the last reset was caused by the watchdog */
    uint32_t watchdog; /* services of the watchdog */
};

/* Initialise the chip as after a reset; the caller initialises the firmware afterwards. */
void chip_init(hal_t *chip, const board_config_t *config, servo_t *servo, const servo_config_t *servo_config);

/* Cut or repair the wire of a pin. */
void chip_cut_wire(hal_t *chip, int axis, int pin, bool cut);

/* Run up to and including `until_ns`; `stop_after_scan`: at most to the next M2 interrupt. True if it stopped for that. */
bool chip_run(hal_t *chip, uint64_t until_ns, bool stop_after_scan);

#endif

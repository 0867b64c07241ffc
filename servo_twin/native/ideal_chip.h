/* ideal_chip.h - a chip without registers: what hal/hal.h promises, straight on the plant.
 *
 * Timing of one PWM period T = 62.5 us (DRM F34), k counts half cycles of T/2:
 *   k even   low-side centre of axis 1, high-side centre of axis 2: currents of 1, offsets of 2, bus; servo_m1_isr
 *   k odd    the other way round: currents of 2, offsets of 1, bus; servo_m2_isr
 * Duties written in an interrupt are loaded at the next half cycle, so they act T/2 after their samples were taken and
 * hold for a whole period. Conversions and software take no time. Comparators and captured edges are looked at once per
 * step of the plant, a half cycle.
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
    double duty[3];     /* as written */
    bool written;       /* not loaded yet */
    bool enabled;
    bool broken;        /* over-current latch */
    bool enable_used;
    bool enable_open;   /* its latch */
    phase_pair_t pair;
    adc_pair_t currents;
    plant_samples_t offsets;
} chip_axis_t;

struct hal {
    servo_t *servo;
    plant_t plant;
    uart_t uart;
    flash_t flash;
    chip_axis_t axis[HAL_AXES];
    uint16_t bus_code; /* ADC code of the bus voltage */
    uint64_t now_ns;     /* what the software would see on a clock */
    uint64_t grid_ns;    /* next step of the plant ends here */
    int sampled;         /* axis whose low sides are at their centre then */
    uint32_t scans;      /* M2 interrupts so far */
    uint32_t breaks;     /* times an over-current latch has tripped */
    uint16_t monitor[HAL_ANALOG_OUTS];
    uint16_t late;       /* hal_late_loops() */
    unsigned left_out;   /* loops in a row */
    uint64_t stalled_ns; /* until then the core does nothing */
    uint64_t served_ns;  /* last service of the watchdog */
    bool watchdog_reset;         /* the watchdog has reset the board */
    uint32_t watchdog;   /* times the watchdog was serviced */
};

/* The chip after reset; the firmware is initialised by the caller afterwards. */
void chip_init(hal_t *chip, const board_config_t *config, servo_t *servo);

/* The wire of a pin is cut, or whole again. */
void chip_cut_wire(hal_t *chip, int axis, int pin, bool cut);

/* Everything that happens up to and including `until_ns`; with `stop_after_scan` no further than the next M2 interrupt.
 * Returns true if it stopped for that. */
bool chip_run(hal_t *chip, uint64_t until_ns, bool stop_after_scan);

#endif

/* hal_data.h - the state of a board below hal/hal.h. */
#ifndef PORT_HAL_DATA_H
#define PORT_HAL_DATA_H

#include <stdbool.h>
#include <stdint.h>

#include "app/servo.h"
#include "hal/hal.h"

#define PORT_RING 64U /* received bytes that wait; a power of two */

typedef struct {
    uint16_t pwm; /* base addresses */
    uint16_t tmr;
    phase_pair_t pair; /* in the channel lists */
    adc_pair_t currents;
    uint16_t others;        /* bits of OUTEN that do not belong to the inverter */
    bool behind;            /* the last duties were released behind the load */
    volatile bool armed;    /* the B-edge interrupt is enabled */
    volatile uint16_t arms; /* times armed */
} port_axis_t;

struct hal {
#ifdef CHIP_ON_HOST
    struct chip *chip;
#endif
    uint32_t baud; /* baud rate, set by the owner of the board; 0: SERIAL_BAUD */
    servo_t *servo;
    port_axis_t axis[HAL_AXES];
    uint16_t bus; /* ADC code of the bus voltage */
    bool watchdog_reset;     /* the last reset was caused by the watchdog */
    uint16_t losses; /* count of lost triggers, with decay */
    uint16_t late;     /* hal_late_loops() */
    uint16_t last;     /* time stamp of the last M1, TIME_STAMP_DIVIDER clocks */
    uint16_t m2_runs;  /* M2 interrupts since the last M1 */
    bool running;      /* M1 has run before */
    bool monitoring;   /* the monitor outputs run */

    bool slow_line; /* the background loop reads received bytes, too */
    volatile uint8_t ring[PORT_RING];
    volatile uint16_t ring_in; /* number of bytes written, modulo 65536 */
    volatile uint16_t ring_out; /* number of bytes read, modulo 65536 */
    volatile uint16_t overruns; /* received bytes lost in the interface or in the ring */
};

#endif

/* port.h - the servo on an MC56F84789: the board's state below hal/hal.h.
 *
 * port_init() once after reset: it sets up every peripheral, initialises the application and starts both carriers; with
 * the start interrupt the circle t0 to t3 of DRM F34 begins. The vector table calls the handlers; on the host the chip's
 * interrupt controller calls port_isr(). Whoever owns the board calls servo_background() whenever nothing else runs.
 */
#ifndef PORT_PORT_H
#define PORT_PORT_H

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
    adc_pair_t offsets;
    uint16_t others;        /* bits of OUTEN that do not belong to the inverter */
    uint16_t sink;          /* code of the heat sink's temperature sensor */
    volatile bool armed;    /* for a B edge that nobody has taken yet */
    volatile uint16_t arms; /* times armed */
} port_axis_t;

struct hal {
#ifdef CHIP_ON_HOST
    struct chip *chip;
#endif
    uint32_t baud; /* of the host's line, chosen by whoever owns the board; 0: SERIAL_BAUD */
    servo_t *servo;
    port_axis_t axis[HAL_AXES];
    uint16_t bus;
    bool bitten;     /* the watchdog has reset the board */
    uint16_t losses; /* of triggers, forgotten with time */
    uint32_t restarts; /* of the sequence, since reset */
    uint16_t late;     /* loops that came after the load of their duties, modulo 65536 */
    uint16_t last;     /* time stamp of the last M1, TIME_STAMP_DIVIDER clocks */
    bool running;      /* M1 has run before */
    bool monitoring;   /* the monitor outputs run */

    volatile uint8_t ring[PORT_RING];
    volatile uint16_t ring_in; /* bytes ever put in and taken out, modulo 65536 */
    volatile uint16_t ring_out;
    uint16_t overruns; /* received bytes lost in the interface or in the ring */
};

/* False if clock or converter do not come up: the outputs stay off, and the watchdog will try again. */
bool port_init(hal_t *hal, servo_t *servo);

/* Handlers, by what they are for. */
void port_start(hal_t *hal); /* PWMA SM0 VAL5, once (DRM 4.3.3) */
void port_m1(hal_t *hal);    /* PWMA SM1 VAL5: t1 */
void port_m2(hal_t *hal);    /* ADC end of scan: t3 */
void port_break_1(hal_t *hal);
void port_break_2(hal_t *hal);
void port_edge_1(hal_t *hal);
void port_edge_2(hal_t *hal);
void port_receive(hal_t *hal);

/* The handler of a vector. */
void port_isr(hal_t *hal, uint16_t vector);

#endif

/* port.h - the servo on an MC56F84789: the board's state below hal/hal.h.
 *
 * port_init() once after reset: it sets up every peripheral, initialises the application and starts both carriers; with
 * the start interrupt the circle t0 to t3 of DRM F34 begins. The vector table calls the handlers; on the host the chip's
 * interrupt controller calls port_isr(). The main program calls servo_background() whenever nothing else runs.
 */
#ifndef PORT_PORT_H
#define PORT_PORT_H

#include "port/mc56f84789/hal_data.h"

/* False if clock or converter do not come up: the outputs stay off, and the watchdog will try again. */
bool port_init(hal_t *hal, servo_t *servo, const servo_config_t *config);

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

/* port.h - the servo on an STM32F405: the board's state below hal/hal.h.
 *
 * port_init() once after reset; then port_background() whenever nothing else runs. The vector table calls the handlers.
 */
#ifndef STM32F405_PORT_H
#define STM32F405_PORT_H

#include "port/stm32f405/hal_data.h"

/* False if the clock or a carrier does not start. Then, or without results of the converters, the switches stay open,
 * and the watchdog will try again. */
bool port_init(hal_t *hal, servo_t *servo, const servo_config_t *config);

void port_background(hal_t *hal);

/* Handlers, by what they are for. */
void port_gate_fault(hal_t *hal);
void port_enable_1(hal_t *hal);
void port_enable_2(hal_t *hal);
void port_stamp(hal_t *hal); /* time of an edge of encoder channel B */
void port_m1(hal_t *hal);    /* t1 */
void port_m2(hal_t *hal);    /* t3 */
void port_edge(hal_t *hal);  /* what is done with an edge */

#endif

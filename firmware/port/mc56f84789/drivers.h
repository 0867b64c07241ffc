/* drivers.h - what the files of this port know of each other. */
#ifndef PORT_DRIVERS_H
#define PORT_DRIVERS_H

#include "port/mc56f84789/access.h"
#include "port/mc56f84789/hal_data.h"
#include "port/mc56f84789/registers.h"
#include "port/mc56f84789/settings.h"

/* Read until the bits under `mask` are `value`; false if they never are. */
bool wait_for(hal_t *hal, uint16_t address, uint16_t mask, uint16_t value);

bool clock_init(hal_t *hal);
void cop_stop(hal_t *hal);
void cop_start(hal_t *hal);
void sim_init(hal_t *hal);
void pins_init(hal_t *hal);
void crossbar_init(hal_t *hal);
void interrupts_init(hal_t *hal);

void pwm_init(hal_t *hal);
void pwm_run(hal_t *hal);

bool adc_init(hal_t *hal);
void adc_stop(hal_t *hal);
void adc_arm(hal_t *hal);
bool adc_take_first(hal_t *hal);  /* results of t0; false if the scan is not where it should be */
bool adc_take_second(hal_t *hal); /* results of t2 */

void timers_init(hal_t *hal);
void serial_init(hal_t *hal);

#endif

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
void pwm_monitor_start(hal_t *hal);

static inline void pwm_write(hal_t *hal, uint16_t module, uint16_t sm, uint16_t reg, uint16_t value)
{
    REG_WRITE(hal, module + PWM_SM(sm) + reg, value);
}

static inline uint16_t pwm_read(hal_t *hal, uint16_t module, uint16_t sm, uint16_t reg)
{
    return REG_READ(hal, module + PWM_SM(sm) + reg);
}

bool adc_init(hal_t *hal);
void adc_stop(hal_t *hal);
void adc_arm(hal_t *hal);
bool adc_take_first(hal_t *hal);  /* results of t0; false if the scan is not where it should be */
bool adc_take_second(hal_t *hal); /* results of t2 */

void timers_init(hal_t *hal);

/* Timers of an encoder (DRM 2.4, F10). */
#define TIMER_COUNT 0U /* quadrature counter, 0..3999 and 0..-3999 */
#define TIMER_STAMP 1U /* free running */
#define TIMER_INDEX 2U /* emulated index pulses */
#define TIMER_AGE 3U   /* restarts at each capture */

static inline uint16_t timer_register(const hal_t *hal, uint16_t axis, uint16_t channel, uint16_t reg)
{
    return (uint16_t)(hal->axis[axis].tmr + TMR_CHANNEL(channel) + reg);
}

void serial_init(hal_t *hal);
void sequence_arm(hal_t *hal);

#endif

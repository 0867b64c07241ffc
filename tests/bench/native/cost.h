/* cost.h - instructions of repeated calls: minimum, maximum, sum and number, per phase of the run. */
#ifndef BENCH_COST_H
#define BENCH_COST_H

#include <stdint.h>

#include "app/servo.h"

/* Counted calls: both interrupts in each PWM period of a slow tick, axis_fast and axis_slow. */
typedef uint16_t cost_kind_t;
#define COST_INTERRUPT(period, second) ((cost_kind_t)(2U * (period) + (second)))
#define COST_FAST COST_INTERRUPT(SERVO_SLOW_PERIODS, 0U)
#define COST_SLOW COST_INTERRUPT(SERVO_SLOW_PERIODS, 1U)
#define COST_KINDS (COST_SLOW + 1U)

void cost_add(cost_kind_t kind, uint32_t instructions);

#endif

/* bench_board.h - a board for measuring the firmware on: the hal functions cost about the register accesses that they
 * would be on a chip, and behind them two motors turn in integer arithmetic, the same on every machine.
 *
 * The motors are simple (no dead time, no saliency, no noise), but the loop is closed: codes, counts and edges change
 * as they do on a moving drive, and so do the ways that the firmware takes.
 */
#ifndef BENCH_BOARD_H
#define BENCH_BOARD_H

#include "hal/hal.h"
#include "math/frac.h"

/* What an interrupt finds in the registers of one axis. */
typedef struct {
    adc_pair_t currents;
    adc_pair_t offsets;
    phase_pair_t pair;
    int16_t duty[3];
    bool enabled;
    bool broken;
    uint16_t count;
    uint16_t index;
    bool armed;
    bool latched;
    edge_capture_t edge;
    uint32_t edge_age;
} bench_registers_t;

typedef struct {
    int32_t i_alpha; /* over the full-scale current, 27 fraction bits */
    int32_t i_beta;
    frac32_t speed;     /* over the full-scale speed */
    int32_t angle;      /* counts with 16 fraction bits, within one turn of either sign */
    uint32_t edge_time; /* of the last edge, timer ticks */
} bench_motor_t;

struct hal {
    bench_registers_t axis[HAL_AXES];
    uint16_t bus;
    uint16_t serial; /* received byte behind a flag in bit 8 */
    uint16_t sent;
    uint16_t watchdog;
    uint16_t monitor[HAL_ANALOG_OUTS];
    bool brake;
    bench_motor_t motor[HAL_AXES];
    uint32_t period;
};

/* Everything at rest, 24 V. */
void bench_board_init(hal_t *hal);

/* One PWM period goes by. */
void bench_board_step(hal_t *hal);

#endif

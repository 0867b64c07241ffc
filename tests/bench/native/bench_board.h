/* bench_board.h - a board to measure the firmware: the hal functions cost about as much as the register accesses on
 * a chip; two motors are simulated in integer arithmetic, with the same results on every machine.
 *
 * The motors are simple (no dead time, no saliency, no noise), but the loop is closed: codes, counts, edges and
 * branches of the firmware vary as in a drive in motion.
 */
#ifndef BENCH_BOARD_H
#define BENCH_BOARD_H

#include "hal/hal.h"
#include "math/frac.h"

/* Register contents of one axis that an interrupt reads. */
typedef struct {
    adc_pair_t currents;
    adc_pair_t offsets;
    phase_pair_t pair;
    int16_t duty[3];
    bool enabled;
    bool tripped;
    uint16_t count;
    uint16_t index;
    bool armed;
    bool captured;
    edge_capture_t edge;
    uint32_t edge_age;
} bench_registers_t;

typedef struct {
    int32_t i_alpha; /* relative to the full-scale current, 27 fraction bits */
    int32_t i_beta;
    frac32_t speed;     /* relative to the full-scale speed */
    int32_t angle;      /* counts with 16 fraction bits, within +-1 revolution */
    uint32_t edge_time; /* of the last edge, timer ticks */
} bench_motor_t;

struct hal {
    bench_registers_t axis[HAL_AXES];
    uint16_t bus;
    uint16_t serial; /* received byte, with a flag in bit 8 */
    uint16_t sent;
    uint16_t watchdog;
    uint16_t monitor[HAL_ANALOG_OUTS];
    bool brake_resistor;
    bench_motor_t motor[HAL_AXES];
    uint32_t period;
};

/* Everything at rest, 24 V. */
void bench_board_init(hal_t *hal);

/* Advance by one PWM period. */
void bench_board_step(hal_t *hal);

#endif

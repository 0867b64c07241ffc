/* register_chip.h - the whole board at register level: the firmware as it is flashed, the chip's registers, and the plant
 * at switching level, soldered together as port/mc56f84789/README.md says.
 */
#ifndef SERVO_TWIN_REGISTER_CHIP_H
#define SERVO_TWIN_REGISTER_CHIP_H

#include <stdbool.h>
#include <stdint.h>

#include "app/servo.h"
#include "chip/chip.h"
#include "plant/switching.h"
#include "port/mc56f84789/port.h"

/* How long the software takes, in bus clocks. */
typedef struct {
    uint32_t m1, m1_slow; /* without and with the slow loop of the other axis in it */
    uint32_t m2, m2_slow;
    uint32_t start, edge, receive, over_current, lost;
} register_cost_t;

typedef struct {
    chip_t chip;
    switching_t plant;
    hal_t hal;
    servo_t *servo;
    register_cost_t cost;
    bool stop_after_scan;
    uint32_t scans; /* M2 interrupts so far */
    uint32_t breaks; /* times a comparator has tripped */
    uint32_t boots; /* times the software has started */
    bool started; /* the last of them has come to its end */
} register_chip_t;

/* Power on; the software boots with the first step. */
void register_chip_init(register_chip_t *board, const board_config_t *config, servo_t *servo);

/* Everything up to and including a bus clock; with `stop_after_scan` no further than the next M2 interrupt. Returns true if
 * it stopped for that. An error stands in chip.error. */
bool register_chip_run(register_chip_t *board, uint64_t until, bool stop_after_scan);

#endif

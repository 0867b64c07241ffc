/* board_chip.h - the chip of this board: the MC56F84789, with the drivers of the firmware. */
#ifndef SERVO_TWIN_BOARD_CHIP_H
#define SERVO_TWIN_BOARD_CHIP_H

#include "chip/chip.h"
#include "port/mc56f84789/port.h"

#define BOARD_BUS core.bus
#define BOARD_LINE sci.line
#define BOARD_FLASH ftfl.flash
#define BOARD_WATCHDOG cop
#define BOARD_GAPS_BEFORE_LINE LEFT_OUT(core.inside), LEFT_OUT(core.outside),
#define BOARD_GAPS_BEHIND_LINE LEFT_OUT(stack),

typedef struct {
    servo_t servo;
    hal_t hal;
    bool up; /* the port has started the servo */
} board_software_t;

/* Bytes from the host; the clock at which the next byte on the line is complete. */
#define chip_line_write(chip, data, size) sci_line_write(&(chip)->sci, data, size)
#define chip_line_next(chip) sci_line_next(&(chip)->sci)

#endif

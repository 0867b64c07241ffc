/* board_chip.h - the chip of the board ODrive v3.6: an STM32F405 with its gate drivers. No firmware is linked: it needs a program. */
#ifndef SERVO_TWIN_BOARD_CHIP_H
#define SERVO_TWIN_BOARD_CHIP_H

#include "app/servo.h"
#include "stm32f405/chip.h"

#define BOARD_BUS soc.bus
#define BOARD_LINE usart.line
#define BOARD_FLASH flash_control.flash
#define BOARD_WATCHDOG iwdg
#define BOARD_GAPS_BEFORE_LINE
#define BOARD_GAPS_BEHIND_LINE

typedef struct {
    servo_t servo; /* unused */
    bool resting;
} board_software_t;

#endif

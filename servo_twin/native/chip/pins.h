/* pins.h - the multiplexer between pins and peripherals: GPIO ports A to G and the function selects of the SIM. */
#ifndef CHIP_PINS_H
#define CHIP_PINS_H

#include <stdbool.h>
#include <stdint.h>

#define GPIO_PORTS 7

/* Pins by port and number: CHIP_PIN('C', 3). */
#define CHIP_PIN(port, number) ((((unsigned)(port) - 'A') << 4) | (unsigned)(number))
#define CHIP_PINS (GPIO_PORTS * 16u)

/* What the board has soldered to them; a peripheral that is routed to another pin drives or hears nothing. */
typedef struct {
    uint8_t gate[2][3][2]; /* module, submodule, 0: upper, 1: lower switch */
    uint8_t txd, rxd;      /* serial line to the host */
} chip_wiring_t;

typedef struct {
    uint16_t pull, data, direction, peripheral, drive_mode, drive, pull_up, slew;
} gpio_port_t;

typedef struct {
    gpio_port_t port[GPIO_PORTS];
    uint16_t select[11];  /* SIM_GPSAL .. SIM_GPSGH */
    uint16_t in[GPIO_PORTS]; /* levels that the board puts on the pins */
    /* what follows */
    uint8_t function[CHIP_PINS]; /* pin_function_t */
    uint16_t gates[GPIO_PORTS];  /* pins that gate drivers are soldered to */
    uint16_t analog;             /* channels of the ADC that have their pins: ANA0-7, ANB0-7 */
} pins_t;

#endif

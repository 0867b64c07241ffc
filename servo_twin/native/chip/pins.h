/* pins.h - the multiplexer between pins and peripherals: GPIO ports A to G and the function selects of the SIM. */
#ifndef CHIP_PINS_H
#define CHIP_PINS_H

#include "chip/bus.h"

#define GPIO_BASE 0xE200u
#define GPIO_END 0xE270u
#define GPIO_PORTS 7

/* Pins by port and number: CHIP_PIN('C', 3). */
#define CHIP_PIN(port, number) ((((unsigned)(port) - 'A') << 4) | (unsigned)(number))
#define CHIP_PINS (GPIO_PORTS * 16u)

#define PINS_GATES 12u
#define PINS_TIMER_INPUTS (QTMR_MODULES * QTMR_CHANNELS)

/* Pins that the board has soldered to gate drivers and serial line; a peripheral that is routed to another pin is not
 * connected. */
typedef struct {
    uint8_t gate[2][3][2]; /* module, submodule, 0: upper, 1: lower switch */
    uint8_t txd, rxd;      /* serial line to the host */
} chip_wiring_t;

/* Functions of a pin. */
typedef enum {
    FUNCTION_GPIO,
    FUNCTION_OTHER, /* one that is not modelled */
    FUNCTION_ANALOG,
    FUNCTION_PWM_A0A, /* + 8 module + 2 submodule + side */
    FUNCTION_FAULT_A0 = FUNCTION_PWM_A0A + 16, /* + 8 module + input */
    FUNCTION_TIMER_A0 = FUNCTION_FAULT_A0 + 16, /* + 4 module + channel */
    FUNCTION_TXD0 = FUNCTION_TIMER_A0 + 8,
    FUNCTION_RXD0 = FUNCTION_TXD0 + SCI_MODULES,
    FUNCTION_XB_IN2 = FUNCTION_RXD0 + SCI_MODULES, /* XB_IN2 .. XB_IN11 */
    FUNCTION_COUNT = FUNCTION_XB_IN2 + 10
} pin_function_t;

typedef struct {
    uint16_t reg[14]; /* PUR to SRE in the order of their addresses, bit per pin */
} gpio_port_t;

typedef struct {
    bus_t *bus;
    chip_wiring_t wiring;
    gpio_port_t port[GPIO_PORTS];
    uint16_t in[GPIO_PORTS];     /* levels that the board drives, bit per pin */
    uint16_t gates[GPIO_PORTS];  /* pins that are soldered to gate drivers, bit per pin */
    /* derived from the registers */
    uint8_t function[CHIP_PINS]; /* pin_function_t */
    uint16_t analog;             /* bit per pin that is routed to the ADC: 0..7 ANA0-7, 8..15 ANB0-7 */
    unsigned xb_in;              /* levels at the crossbar's inputs, bit n: XB_INn */
} pins_t;

void pins_power_on(pins_t *pins, bus_t *bus, const chip_wiring_t *wiring);

uint16_t gpio_read(void *pins, uint32_t address);
void gpio_write(void *pins, uint32_t address, uint16_t value);
void pins_reset(void *pins);

/* After a change of a function select, a port's PER, SIM_IPS0. */
void pins_route(pins_t *pins);

/* The board drives a level from the present clock on; or its edge is reported to a timer apart from this. */
void pins_set(pins_t *pins, unsigned pin, bool level);
void pins_set_late(pins_t *pins, unsigned pin, bool level);

/* Level of a pin, driven by the chip or the board. */
bool pins_level(const pins_t *pins, unsigned pin);

/* What drives the gate pins of a submodule; side 0: upper, 1: lower switch. */
gate_pin_t pins_gate(const pins_t *pins, unsigned module, unsigned submodule, unsigned side);

/* SCI that is routed to the serial line; SCI_MODULES: none. */
unsigned pins_sender(const pins_t *pins);
unsigned pins_receiver(const pins_t *pins);

/* Timer input that a pin is routed to: 4 module + channel; PINS_TIMER_INPUTS: none. */
unsigned pins_timer_input(const pins_t *pins, unsigned pin);

#endif

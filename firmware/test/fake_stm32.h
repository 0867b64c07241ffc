/* fake_stm32.h - the STM32F405 port without a chip: registers with memory, and a list of all accesses in order.
 *
 * A read returns the last value written or set. Effects of accesses: clocks come up and lock their settings, TIM1 starts TIM8, flags are
 * cleared as on the chip, BSRR changes ODR, each read of TIM5 takes some clocks, and two gate drivers answer on SPI3:
 * reading their status clears it.
 * Calls of the application (app/servo.h) are also in the list.
 */
#ifndef FAKE_STM32_H
#define FAKE_STM32_H

#include <stdbool.h>
#include <stdint.h>

#include "port/stm32f405/port.h"

#define FAKE_ACCESSES 65536
#define FAKE_REGISTERS 0x100000 /* words from 4000_0000, E000_0000 and 0800_0000 */

typedef enum { FAKE_READ, FAKE_WRITE, FAKE_INTERRUPTS, FAKE_SERVO } fake_kind_t;
typedef enum { FAKE_INIT, FAKE_M1, FAKE_M2, FAKE_EDGE, FAKE_BREAK, FAKE_BACKGROUND } fake_servo_t;

typedef struct {
    int kind;
    uint32_t address; /* or fake_servo_t */
    uint32_t value;   /* or axis */
} fake_access_t;

typedef struct chip {
    uint32_t memory[3][FAKE_REGISTERS];
    fake_access_t access[FAKE_ACCESSES];
    int accesses;
    uint32_t clocks_per_read; /* of TIM5 */
    uint16_t driver[2][4];    /* registers of the gate drivers */
    uint16_t answer[2];       /* to the next frame */
    int lost_writes;          /* frames that the drivers do not take */
    bool takes_edge;          /* the application takes a captured edge in servo_edge_isr */
    edge_capture_t taken;
    bool masked;                            /* interrupts are off */
    void (*interrupt)(struct chip *chip);     /* before and behind each access, unless they are off */
} fake_chip_t;

fake_chip_t *fake_new(void);
void fake_free(fake_chip_t *chip);
hal_t *fake_hal(fake_chip_t *chip);
servo_t *fake_servo(fake_chip_t *chip);
void serial_service(hal_t *hal);
uint32_t fake_get(fake_chip_t *chip, uint32_t address);
void fake_set(fake_chip_t *chip, uint32_t address, uint32_t value);

#endif

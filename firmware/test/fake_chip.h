/* fake_chip.h - the port without a chip: registers with memory, and a list of all accesses in order.
 *
 * A read returns the last value written or set; a write is added to the list and has those effects on flags that the
 * port uses: write 1 to clear in PWM STS, FSTS0 and ADC STAT, RDY cleared by reading a result, LDOK by CLDOK.
 * Calls of the application (app/servo.h) are also in the list.
 */
#ifndef FAKE_CHIP_H
#define FAKE_CHIP_H

#include <stdbool.h>
#include <stdint.h>

#include "port/mc56f84789/port.h"

#define FAKE_ACCESSES 8192

typedef enum { FAKE_READ, FAKE_WRITE, FAKE_INTERRUPTS, FAKE_SERVO } fake_kind_t;
typedef enum { FAKE_INIT, FAKE_M1, FAKE_M2, FAKE_EDGE, FAKE_BREAK } fake_servo_t;

typedef struct {
    int kind;
    uint32_t address; /* or fake_servo_t */
    uint16_t value;   /* or axis */
} fake_access_t;

typedef struct chip {
    uint16_t memory[65536];
    fake_access_t access[FAKE_ACCESSES];
    int accesses;
    uint16_t data[16]; /* bytes in the receiver */
    int data_in, data_out;
    bool takes_edge; /* the application reads a captured edge in servo_edge_isr */
    edge_capture_t taken;
    int slip; /* number of writes to a timer until an edge occurs */
} fake_chip_t;

fake_chip_t *fake_new(void);
void fake_free(fake_chip_t *chip);
hal_t *fake_hal(fake_chip_t *chip);
void fake_baud(fake_chip_t *chip, uint32_t baud);
servo_t *fake_servo(fake_chip_t *chip);
void fake_receive(fake_chip_t *chip, uint8_t byte);

#endif

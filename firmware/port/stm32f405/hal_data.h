/* hal_data.h - the state of a board below hal/hal.h. */
#ifndef STM32F405_HAL_DATA_H
#define STM32F405_HAL_DATA_H

#include <stdbool.h>
#include <stdint.h>

#include "app/servo.h"
#include "hal/hal.h"

#define RING_BYTES 256U /* of either direction of the serial line; a power of two */

/* What DMA reads and writes. */
typedef struct {
    volatile uint16_t adc2[2]; /* phase b of motor 2, offset b of motor 1 */
    volatile uint16_t adc3[2]; /* the same of c */
    volatile uint8_t receive[RING_BYTES];
    volatile uint8_t transmit[RING_BYTES];
} dma_memory_t;

typedef enum {
    GATE_FAILED, /* not started, or the drivers have reported a fault */
    GATE_READY,
    GATE_STARTING, /* being set up, and no fault since */
} gate_state_t;

typedef struct {
    uint32_t pwm; /* base addresses */
    uint32_t encoder;
    adc_pair_t currents; /* phases b, c */
    adc_pair_t offsets;
    volatile bool tripped; /* over-current: the switches stay open until it is cleared */
    volatile bool opened;  /* the enable input has been open */
    bool enable_used;
    bool behind; /* the last duties were released behind the load */

    uint16_t raw;    /* counter of the encoder timer at the last update */
    uint16_t count;  /* hal_encoder_count() */
    uint16_t index;  /* hal_index_count() */
    uint16_t period; /* counts per turn */

    volatile bool armed;       /* the next edge of channel B is captured */
    volatile bool captured;    /* an edge was captured since arming */
    volatile bool uncounted;   /* a pulse that the timer has not counted has closed the line */
    uint16_t armed_raw; /* counter of the timer at arming */
    volatile uint32_t edge_at; /* core clocks at the captured edge */
    volatile uint16_t edge_raw; /* counter of the timer at that edge */
    volatile uint16_t edges; /* captured edges, modulo 65536 */
    uint16_t edges_old; /* `edges` when the last one was longer ago than hal_edge_age() can say */
} port_axis_t;

struct hal {
#ifdef CHIP_ON_HOST
    struct chip *chip;
#endif
    dma_memory_t *dma;
    uint32_t baud; /* baud rate, set by the owner of the board; 0: SERIAL_BAUD */
    servo_t *servo;
    port_axis_t axis[HAL_AXES];
    uint16_t bus; /* ADC code of the bus voltage */
    bool watchdog_reset; /* the last reset was caused by the watchdog */
    uint16_t losses;     /* count of lost triggers, with decay */
    uint16_t late;       /* hal_late_loops() */
    uint32_t last;       /* core clocks at the last M1 */
    uint16_t m2_runs;    /* M2 interrupts since the last M1 */
    bool running;        /* M1 has run before */
    bool braking;        /* the brake resistor is on */

    volatile gate_state_t gate;
    uint32_t gate_checked; /* core clocks at the last check of the gate drivers */
    uint16_t gate_status[HAL_AXES]; /* status register 1 when it was last not 0, for a debugger */

    uint16_t receive_out; /* bytes taken from the ring of received bytes, modulo 65536 */
    uint16_t receive_laps; /* times that DMA has filled the ring, modulo 65536 */
    uint16_t transmit_in; /* bytes put into the ring of sent bytes, modulo 65536 */
    uint16_t transmit_out; /* bytes sent, modulo 65536 */
    uint16_t transmitting; /* bytes of the transfer in progress */
    uint16_t overruns; /* received bytes lost in the interface or in the ring */
};

#endif

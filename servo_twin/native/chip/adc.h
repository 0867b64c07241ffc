/* adc.h - 12-bit cyclic converters A and B, parallel scans.
 *
 * A scan begins with the first edge of the ADC clock at or after the sync pulse. The first pair is held 2.5 ADC clocks
 * later and complete after 8.5; each further one follows after 6 (DRM 1.4). A pause ends the row: the next pair starts
 * like a first one.
 */
#ifndef CHIP_ADC_H
#define CHIP_ADC_H

#include <stdbool.h>
#include <stdint.h>

#define ADC_SAMPLES 16
#define ADC_PAIRS 8
#define ADC_CONVERTERS 2

typedef struct {
    bool scanning;        /* CIP */
    bool converting;      /* between a sync and the last result of the row */
    unsigned pair;        /* next to be held */
    uint64_t hold_clock;  /* when it is */
    uint64_t ready_clock; /* when its result is there */
    uint64_t end_clock;   /* last result of the row; CHIP_NEVER while more follow */
    uint64_t sync_clock;  /* last sync pulse */
} adc_converter_t;

typedef struct {
    uint16_t ctrl1, ctrl2, clist[4], sdis, stat, rdy, result[ADC_SAMPLES], offset[ADC_SAMPLES];
    uint16_t pwr, cal, sctrl, pwr2, ctrl3, schlten;
    uint8_t channel[ADC_SAMPLES];  /* of each sample, as CLIST has it */
    uint64_t ready[ADC_SAMPLES];   /* clock at which `waiting` becomes the result; CHIP_NEVER without one */
    uint16_t waiting[ADC_SAMPLES];
    unsigned waits;                /* bit n: sample n waits */
    uint64_t power_clock[ADC_CONVERTERS]; /* when the power-up delay is over */
    adc_converter_t converter[ADC_CONVERTERS];
} adc_t;

#endif

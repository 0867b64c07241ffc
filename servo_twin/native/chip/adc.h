/* adc.h - 12-bit cyclic converters A and B, parallel scans.
 *
 * A scan begins with the first edge of the ADC clock at or after the sync pulse. The first pair is held 2.5 ADC clocks
 * later and complete after 8.5; each further one follows after 6 (DRM 1.4). A pause ends the row: the next pair starts
 * like a first one. Clocks are those of the bus (10 ns).
 */
#ifndef CHIP_ADC_H
#define CHIP_ADC_H

#include "chip/bus.h"

#define ADC_BASE 0xE500u
#define ADC_END 0xE556u

#define ADC_SAMPLES 16
#define ADC_PAIRS 8

typedef struct {
    bool scanning;         /* CIP */
    bool converting;       /* between a sync pulse and the last result of the row */
    unsigned pair;         /* pair to be sampled next */
    uint64_t sample_clock; /* time of sampling */
    uint64_t ready_clock;  /* time of its result */
    uint64_t end_clock;    /* time of the last result of the row; CHIP_NEVER while more pairs follow */
    uint64_t sync_clock;   /* time of the last sync pulse */
} adc_converter_t;

typedef struct {
    bus_t *bus;
    uint16_t connected; /* bit per analogue pin that is routed to the ADC: 0..7 ANA0-7, 8..15 ANB0-7 */
    uint16_t reg[ADC_END - ADC_BASE]; /* by offset; results and offsets in 1/8 codes of 12 bits */
    uint8_t channel[ADC_SAMPLES];         /* pin of each sample, from CLIST */
    uint64_t ready[ADC_SAMPLES];          /* clock at which `waiting` becomes the result */
    uint16_t waiting[ADC_SAMPLES];        /* 1/8 codes */
    unsigned waits;                       /* bit n: sample n is not ready yet */
    uint64_t power_clock[ADC_CONVERTERS]; /* end of the power-up delay */
    adc_converter_t converter[ADC_CONVERTERS];
} adc_t;

uint16_t adc_read(void *adc, uint32_t address);
void adc_write(void *adc, uint32_t address, uint16_t value);
void adc_reset(void *adc);
NOINLINE void adc_event(void *adc, unsigned source);

/* Pulse at a sync input. */
void adc_sync(adc_t *adc, unsigned converter);

#endif

/* adc.h - the three converters: injected and regular sequences, their triggers, sample times, the analog watchdog.
 *
 * A trigger starts a sequence ADC_LATENCY clocks of the converter later; a channel is held at the end of its sample time and its result
 * is there 12 clocks of the converter later. An injected trigger interrupts a regular conversion, which then begins anew.
 */
#ifndef STM32F405_ADC_H
#define STM32F405_ADC_H

#include "stm32f405/soc.h"

#define ADC_LATENCY 2u /* the manual states at most 3 */

typedef enum { ADC_NOTHING, ADC_REGULAR, ADC_INJECTED } adc_group_t;

typedef struct {
    uint32_t sr, cr1, cr2, smpr[2], jofr[4], htr, ltr, sqr[3], jsqr, jdr[4], dr;
    adc_group_t runs;
    unsigned rank; /* of the present conversion */
    bool held; /* its channel is held: the conversion follows */
    uint16_t code; /* of the held channel */
    bool regular_waits; /* interrupted, or triggered meanwhile */
    unsigned regular_rank; /* at which it begins anew */
} adc_module_t;

typedef struct {
    soc_t *soc;
    adc_module_t module[SOC_ADCS];
    uint32_t ccr;
} adc_t;

uint32_t adc_read(void *adc, uint32_t offset); /* from ADC1 on */
void adc_write(void *adc, uint32_t offset, uint32_t value);
void adc_reset(void *adc, soc_reset_t cause);
void adc_event(void *adc, unsigned source);

/* An edge of a trigger of the timers. */
void adc_trigger(adc_t *adc, soc_timer_t timer, soc_trigger_t trigger, bool rising);

#endif

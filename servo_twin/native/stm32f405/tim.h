/* tim.h - a timer: TIM1 and TIM8 with complementary outputs, TIM2 to TIM5 and TIM12.
 *
 * The counter is a function of time. Its position counts the ticks of a cycle: edge-aligned 0..ARR, centre-aligned 0..2 ARR - 1, of
 * which the second half counts down. An event is the end of a cycle, the overflow in its middle, a compare of a channel that has
 * a mode or an interrupt, the end of a dead time. In encoder mode it counts the edges at its inputs.
 *
 * Channels in mode 0 (frozen) without an interrupt set no flags. Filters of inputs have no delay. An output compare acts in the
 * tick in which the counter reaches the value; update events come first.
 */
#ifndef STM32F405_TIM_H
#define STM32F405_TIM_H

#include "stm32f405/soc.h"

#define TIM_CHANNELS 4

typedef struct {
    uint32_t ccr, active; /* as written, as compared */
    bool ref; /* OCxREF */
    bool out; /* input of the dead-time unit, as last driven */
    uint64_t dead_clock; /* end of the dead time in progress; CHIP_NEVER without one */
    unsigned levels; /* of the outputs: bit 0 OCx, bit 1 OCxN */
} tim_channel_t;

typedef struct {
    soc_t *soc;
    uint8_t id; /* soc_timer_t */
    uint32_t cr1, cr2, smcr, dier, sr, ccmr[2], ccer, psc, arr, rcr, bdtr;
    uint32_t active_psc, active_arr; /* in force */
    uint32_t repetitions; /* overflows and underflows until the next update event */
    bool locked; /* LOCK has been written */
    uint64_t origin; /* clock of position 0, while the counter runs by time */
    uint32_t position; /* otherwise; in encoder mode the count */
    uint32_t done; /* events up to this position are handled */
    bool down; /* last direction in encoder mode */
    bool input[2]; /* levels of TI1, TI2 */
    tim_channel_t channel[TIM_CHANNELS];
} tim_t;

uint32_t tim_read(void *tim, uint32_t offset);
void tim_write(void *tim, uint32_t offset, uint32_t value);
void tim_reset(void *tim, soc_reset_t cause);
void tim_event(void *tim, unsigned source);
void tim_init(tim_t *tim, soc_t *soc, soc_timer_t id);

/* Level at TI1 (0) or TI2 (1). */
void tim_input(tim_t *tim, unsigned input, bool level);

/* TRGO of another timer rises, or is a pulse. */
void tim_internal_trigger(tim_t *tim, soc_timer_t from);

/* Present count. */
uint32_t tim_count(const tim_t *tim);

#endif

/* environment.h - what is connected to the pins of the chip, and the software that its core runs: a table of functions.
 *
 * The board or a test fills it in and passes it to chip_init with `board`, the first argument of each call. Clocks are those of the
 * 100 MHz bus since power-on.
 */
#ifndef CHIP_ENVIRONMENT_H
#define CHIP_ENVIRONMENT_H

#include <stdint.h>

typedef struct {
    /* Advance the plant to `clock` (never back). */
    void (*advance)(void *board, uint64_t clock);

    /* Clock of the plant's next event, CHIP_NEVER without one; called before each event of the chip. */
    uint64_t (*next_event)(void *board);

    /* The present clock is that of the plant's event: report it by chip_pin. */
    void (*handle_events)(void *board);

    /* The result of chip_deferrable_edges may have changed. */
    void (*deferrable_edges_changed)(void *board);

    /* Report by chip_pin_late the edges that were deferred, up to the present clock. */
    void (*report_deferred)(void *board);

    /* Levels of a pair of gate signals from the present clock on: bit 0 the upper switch (PWM_A), bit 1 the lower one (PWM_B). */
    void (*set_gates)(void *board, unsigned module, unsigned submodule, unsigned levels);

    /* The software has written to a data or direction register of a port. */
    void (*outputs_changed)(void *board);

    /* 12-bit code of an analogue pin at the present clock: 0..7 ANA0-7, 8..15 ANB0-7. */
    uint16_t (*convert)(void *board, unsigned channel);

    /* Software after a reset; its memory is lost. */
    void (*boot)(void *board);

    /* Body of an interrupt. Returns clocks by which it takes longer than what it was charged (core_time.h). */
    uint32_t (*interrupt)(void *board, unsigned vector);

    /* Software that runs while no interrupt does. */
    void (*background)(void *board);
} chip_environment_t;

#endif

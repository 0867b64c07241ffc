/* core.h - interrupt controller and the core as a resource: whose turn it is, and for how long. */
#ifndef CHIP_CORE_H
#define CHIP_CORE_H

#include <stdbool.h>
#include <stdint.h>

#define CORE_VECTORS 111
#define CORE_LEVELS 3   /* priority levels of peripherals */
#define CORE_BACKGROUND (-1) /* the level of what every interrupt interrupts */
#define CORE_STACK 0x40000   /* bytes of the host's stack for the software and what it calls */

/* Interrupt vectors. */
typedef enum {
    VECTOR_TMRB3 = 21,
    VECTOR_TMRB0 = 24,
    VECTOR_TMRA3 = 25,
    VECTOR_TMRA0 = 28,
    VECTOR_ADC_CC1 = 29,
    VECTOR_ADC_CC0 = 30,
    VECTOR_SCI2_RERR = 43,
    VECTOR_SCI1_RERR = 47,
    VECTOR_SCI0_RERR = 51, /* then RCV, TIDLE, TDRE */
    VECTOR_PWMB_FAULT = 63,
    VECTOR_PWMB_RERR = 64,
    VECTOR_PWMA_FAULT = 77,
    VECTOR_PWMA_RERR = 78,
    VECTOR_COP = 108,
} core_vector_t;

/* How fast the core is. */
typedef struct {
    double cycles_per_instruction;
    unsigned entry_clocks; /* of an interrupt: vector, registers saved and restored */
} core_speed_t;

typedef struct {
    /* interrupt controller */
    uint16_t ipr[13], vba, ctrl;
    uint64_t request[2];            /* bit per vector: the peripheral asks */
    uint64_t enabled[CORE_LEVELS][2];
    /* Look for a handler to start, or for the background. Not beside other flags: read together with them, just written, it
     * would keep a processor waiting until the write is through. */
    bool changed;
    /* core */
    int level;                      /* of the handler that runs */
    bool booting;                   /* every access takes time, no interrupts */
    bool masked;                    /* all interrupts of peripherals */
    bool background_due;
    uint32_t polls;                 /* reads since time last moved */
    uint64_t access_clocks;         /* per access while booting */
    /* the software's time */
    uint64_t unit_clocks;           /* of 1/16 instruction, 2^-20 clocks */
    int given;                      /* units until the next event, when time last moved */
    uint64_t horizon;               /* nothing happens before this clock; 0: it is not known any more */
    uint64_t part;                  /* of a clock that has been spent since, 2^-20 */
} core_t;

#endif

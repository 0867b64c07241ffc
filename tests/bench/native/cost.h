/* cost.h - instructions of what is called again and again: least, most, sum and number, per phase of the run. */
#ifndef BENCH_COST_H
#define BENCH_COST_H

#include <stdint.h>

/* What is counted. */
typedef enum {
    COST_M1,       /* interrupt M1 with nothing but the fast loop */
    COST_M2,
    COST_M1_SLOW,  /* with commands, supervision of the host and the slow loop of motor 2 */
    COST_M2_SLOW,  /* with the slow loop of motor 1 and the snapshot */
    COST_M1_WATCH, /* with what watches motor 2 */
    COST_M2_WATCH, /* with what watches motor 1 */
    COST_FAST,     /* axis_fast */
    COST_SLOW,     /* axis_slow */
    COST_KINDS,
} cost_kind_t;

void cost_add(cost_kind_t kind, uint32_t instructions);

#endif

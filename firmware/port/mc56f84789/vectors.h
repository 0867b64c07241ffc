/* vectors.h - which interrupts the servo uses: vector, level, handler (port.h). */
#ifndef PORT_VECTORS_H
#define PORT_VECTORS_H

#include "port/mc56f84789/registers.h"
#include "port/mc56f84789/settings.h"

#define PORT_VECTORS(V)                                                                                                \
    V(VECTOR_PWMA_FAULT, LEVEL_BREAK, port_break_1)                                                                    \
    V(VECTOR_PWMB_FAULT, LEVEL_BREAK, port_break_2)                                                                    \
    V(VECTOR_PWMA_CMP1, LEVEL_LOOPS, port_m1)                                                                          \
    V(VECTOR_ADC_CC0, LEVEL_LOOPS, port_m2)                                                                            \
    V(VECTOR_PWMA_CMP0, LEVEL_LOOPS, port_start)                                                                       \
    V(VECTOR_TMRA_0, LEVEL_EDGE, port_edge_1)                                                                          \
    V(VECTOR_TMRB_0, LEVEL_EDGE, port_edge_2)                                                                          \
    V(VECTOR_QSCI0_RCV, LEVEL_SERIAL, port_receive)

/* Entries in the table of a chip. */
void isr_break_1(void);
void isr_break_2(void);
void isr_m1(void);
void isr_m2(void);
void isr_start(void);
void isr_edge_1(void);
void isr_edge_2(void);
void isr_receive(void);
void isr_unexpected(void);

#endif

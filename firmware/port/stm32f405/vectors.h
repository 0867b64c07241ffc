/* vectors.h - which interrupts the servo uses: number, priority, handler (port.h). */
#ifndef STM32F405_VECTORS_H
#define STM32F405_VECTORS_H

#include "port/stm32f405/port.h"
#include "port/stm32f405/registers.h"
#include "port/stm32f405/settings.h"

#define PORT_VECTORS(V)                                                                                                \
    V(IRQ_EXTI2, PRIORITY_BREAK, port_gate_fault)                                                                      \
    V(IRQ_EXTI0, PRIORITY_BREAK, port_enable_1)                                                                        \
    V(IRQ_EXTI1, PRIORITY_BREAK, port_enable_2)                                                                        \
    V(IRQ_EXTI9_5, PRIORITY_STAMP, port_stamp)                                                                         \
    V(IRQ_ADC, PRIORITY_LOOPS, port_m1)                                                                                \
    V(IRQ_DMA2_STREAM2, PRIORITY_LOOPS, port_m2)                                                                       \
    V(IRQ_EXTI15_10, PRIORITY_EDGE, port_edge)

#endif

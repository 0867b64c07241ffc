/* board_clock.h - unit of time of a board at register level: the fastest clock of its chip, by which its timers switch the gates.
 * Chip, plant and core count these clocks since power-on. */
#ifndef SERVO_TWIN_BOARD_CLOCK_H
#define SERVO_TWIN_BOARD_CLOCK_H

#include <stdint.h>

#if defined(BOARD_ODRIVE36)
#define BOARD_CLOCK_MHZ 168 /* core of the STM32F405 */
#else
#define BOARD_CLOCK_MHZ 100 /* bus of the MC56F84789 */
#endif

/* Clocks that have begun up to a time, and the time of a clock, rounded down. */
static inline uint64_t board_clocks(uint64_t ns) { return ns * BOARD_CLOCK_MHZ / 1000u; }
static inline uint64_t board_clocks_ns(uint64_t clocks) { return clocks * 1000u / BOARD_CLOCK_MHZ; }

#endif

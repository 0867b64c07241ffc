/* board_clock.h - the fastest clock of the chip of a board, by which its timers switch the gates. At register level chip, plant and
 * core count these clocks since power-on. */
#ifndef SERVO_TWIN_BOARD_CLOCK_H
#define SERVO_TWIN_BOARD_CLOCK_H

#include <stdint.h>

#if defined(BOARD_ODRIVE36)
#define BOARD_CLOCK_MHZ 168 /* core of the STM32F405 */
#define BOARD_STAMP_CLOCKS 256u /* of a period of the time stamps of encoder edges */
#else
#define BOARD_CLOCK_MHZ 100 /* bus of the MC56F84789 */
#define BOARD_STAMP_CLOCKS 128u
#endif

/* Clocks that have begun up to a time, and the time of a clock, rounded down. */
static inline uint64_t board_clocks(uint64_t ns) { return ns * BOARD_CLOCK_MHZ / 1000u; }
static inline uint64_t board_clocks_ns(uint64_t clocks) { return clocks * 1000u / BOARD_CLOCK_MHZ; }

/* Time stamp of an encoder edge, in periods of BOARD_TIMER_CLOCK_HZ. */
static inline uint64_t board_stamp(uint64_t ns) { return board_clocks(ns) / BOARD_STAMP_CLOCKS; }

#endif

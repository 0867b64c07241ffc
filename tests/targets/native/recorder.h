/* recorder.h - records inputs and outputs through hal/hal.h while a virtual board runs.
 *
 * The linker inserts the recorder between core and board (--wrap) for all entry points and all hal functions. It is for
 * one board per process at a time, from record_begin, before the board is created, to record_end, as the wrapped
 * functions have no context argument.
 */
#ifndef TARGETS_RECORDER_H
#define TARGETS_RECORDER_H

#include <stddef.h>
#include <stdint.h>

/* CFFI-BEGIN: also read by the Python side */
void record_begin(uint32_t check_every);

/* Close the recording; false if a limit was exceeded, with the reason in record_problem. */
_Bool record_end(void);
const char *record_problem(void);

/* The recording; valid until the next record_begin. */
size_t record_size(void);
const uint8_t *record_bytes(void);
uint32_t record_periods(void);
uint32_t record_digest(void);
size_t record_checks(void);
const uint32_t *record_check_values(void);

/* All calls with their outputs in order, in words of two bytes, low byte first: period (low word first), kind,
 * axis, number of words out, words out, number of snapshot scalars (0 without a new snapshot), and for each its index and
 * value (low word first). */
size_t record_log_size(void); /* bytes */
const uint8_t *record_log(void);

/* Disturb the inputs of the core: of the axes in the mask, each current and offset code, each captured edge and its age
 * is replaced by a random value once in `one_in` reads, and so is the code of the bus; 0 ends the disturbance. Counts
 * are not disturbed, as they must not jump. */
void record_disturb(uint16_t axes, uint32_t one_in, uint32_t seed);

/* Suppress the index pulses of the core, or end that. */
void record_lose_index(_Bool lost);
/* CFFI-END */

#endif

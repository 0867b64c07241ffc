/* recorder.h - writes down what crosses hal/hal.h while a virtual board runs.
 *
 * The linker puts the recorder between core and board (--wrap): every call of an entry point and every call of a hal
 * function passes through it. It is for one board per process at a time, from record_begin before the board is made to
 * record_end; the wrapped functions cannot carry a context of their own.
 */
#ifndef TARGETS_RECORDER_H
#define TARGETS_RECORDER_H

#include <stddef.h>
#include <stdint.h>

/* CFFI-BEGIN: also read by the Python side */
void record_begin(uint32_t check_every);

/* Close the recording; false when something did not fit, and record_problem says what. */
_Bool record_end(void);
const char *record_problem(void);

/* What was recorded; valid until the next record_begin. */
size_t record_size(void);
const uint8_t *record_bytes(void);
uint32_t record_periods(void);
uint32_t record_digest(void);
size_t record_checks(void);
const uint32_t *record_check_values(void);

/* All calls with what they did, one after the other, in words of two bytes, low one first: period (low word first), kind,
 * axis, number of words out, words out, number of snapshot scalars (0 without a new snapshot), and for each its index and
 * value (low word first). */
size_t record_log_size(void); /* bytes */
const uint8_t *record_log(void);

/* Let the core see something else than the board shows: of the axes in the mask, each current and offset code, each
 * captured edge and its age is replaced by a random one once in `one_in` reads, and so is the code of the bus; 0 ends
 * it. Counts are left alone, they may not jump. */
void record_disturb(uint16_t axes, uint32_t one_in, uint32_t seed);

/* Let the core see no further index pulses for a while. */
void record_lose_index(_Bool lost);
/* CFFI-END */

#endif

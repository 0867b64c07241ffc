/* exported_board.h - a board for other simulators at level ideal: its quantities are numbers behind value references.
 *
 * A value reference is EXPORTED_BLOCK times a kind plus an index into the inputs, the variables of the firmware, the numbers of
 * board_truth_t of an axis, or those of the structures of the plant. The exporter (exported_board.py) knows their names.
 */
#ifndef EXPORTED_BOARD_H
#define EXPORTED_BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "board.h"

#define EXPORTED_BLOCK 1000u

enum {
    EXPORTED_TIME,
    EXPORTED_INPUT = 1,
    EXPORTED_FIRMWARE,
    EXPORTED_TRUTH, /* + axis */
    EXPORTED_PLANT = 5, /* + axis */
    EXPORTED_BUS = 7
};

typedef struct exported exported_t;

typedef enum {
    EXPORTED_DONE,
    EXPORTED_REFUSED, /* the value; the board goes on as before */
    EXPORTED_FAILED, /* the call */
} exported_status_t;

typedef struct {
    exported_status_t status;
    const char *what, *where; /* unless done: what is wrong, with which quantity */
} exported_result_t;

/* Names of the value references. */
typedef struct {
    const char *name;
    uint32_t reference;
    bool writable;
} exported_variable_t;

const exported_variable_t *exported_variables(size_t *n);
const exported_variable_t *exported_variable(const char *name); /* NULL: there is none */

const char *exported_fault_name(unsigned bit); /* of axisN.faults; "": there is none */

exported_t *exported_new(void); /* NULL: out of memory */
void exported_free(exported_t *exported);

/* As after exported_new. */
void exported_reset(exported_t *exported);

/* Identity of this export. */
const char *exported_token(void);

/* Inputs and tunable parameters at any time, other parameters before the start. Values are kept until the start. */
exported_result_t exported_set(exported_t *exported, uint32_t reference, double value);
exported_result_t exported_get(const exported_t *exported, uint32_t reference, double *value);
double exported_number(const exported_t *exported, uint32_t reference); /* of a reference that exists */

/* Power on; `time` is that of the other simulator [s]. */
exported_result_t exported_start(exported_t *exported, double time);
double exported_start_time(const exported_t *exported);

/* NULL: not started. */
board_t *exported_board(const exported_t *exported);

/* A point of a path: the shaft of an axis passes `position` [rad] with `velocity` [rad/s] at a tick of the firmware (app/points.c). */
typedef struct {
    int axis;
    uint32_t tick;
    double position, velocity;
} exported_point_t;

/* Send one point per axis; the firmware takes one write in a slow tick. Refused are values that it has no number for; whether it
 * accepts the points, its variable point_refusal says later. */
exported_result_t exported_points(const exported_t *exported, const exported_point_t *points, size_t n);

/* A whole state, of any export with the same token. `size` becomes its size; it is written only if it fits into `room`. */
exported_result_t exported_save(const exported_t *exported, uint8_t *state, size_t room, size_t *size);
exported_result_t exported_restore(exported_t *exported, const uint8_t *state, size_t size);

/* What is wrong with bytes that should be a state; NULL: nothing that can be seen. */
const char *exported_state_problem(const uint8_t *state, size_t size);

#endif

/* scope.h - list of variables that the client reads repeatedly with one request (SETSCOPE, READSCOPE). */
#ifndef COMM_SCOPE_H
#define COMM_SCOPE_H

#include <stdint.h>

#include "comm/payload.h"
#include "comm/status.h"
#include "comm/tsa.h"

#define SCOPE_SLOTS 28

typedef struct {
    tsa_place_t slot[SCOPE_SLOTS]; /* variables; size 0: not set, no bytes in the answer */
    uint8_t count; /* slots in use; 0: off */
} scope_t;

void scope_init(scope_t *scope);

/* Execute the operations of a SETSCOPE request up to the first error; the operations before it remain in effect. */
fm_status_t scope_configure(scope_t *scope, const tsa_space_t *space, payload_reader_t *operations);

/* Append the values of all slots; the caller must freeze the snapshot of the application. */
fm_status_t scope_read(const scope_t *scope, const tsa_space_t *space, payload_writer_t *reply);

#endif

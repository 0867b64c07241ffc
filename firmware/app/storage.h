/* storage.h - non-volatile storage of parameters and configuration: two copies in the data flash, written alternately.
 *
 * A save overwrites the copy that is not the newest valid one. The checksum is written last, so after a power failure
 * either the old or the new set is valid. At a reset the newest valid copy with the layout of this firmware is loaded
 * before the axes are initialised; otherwise the built-in values are used.
 *
 * Runs in the background loop, one flash command per call, only while both axes are at rest with their outputs off.
 * Commands are not stored, so a stored set causes no motion.
 */
#ifndef SERVO_APP_STORAGE_H
#define SERVO_APP_STORAGE_H

#include "app/event_log.h"
#include "app/stored_set.h"
#include "drive/axis_data.h"

typedef struct {
    uint16_t kind; /* STORAGE_REQUEST_ of the last accepted request */
    uint16_t token; /* token of the last accepted request; 0: none */
    uint16_t copy; /* copy that is being written or erased */
    uint16_t step; /* number of completed flash commands */
    uint16_t kept; /* copy that is not overwritten; STORAGE_COPIES: none is usable */
    bool running; /* a flash command is in progress, or its result is not evaluated yet */
    bool changed; /* a value that is stored has changed since the start of the request */
    uint32_t word; /* word that is being programmed */
    uint32_t crc; /* CRC-32 of the words before `word` */
} storage_t;

/* Data of the board. */
typedef struct {
    hal_t *hal;
    const axis_t *axes;
    stored_values_t values;
    event_log_t *event_log;
    bool reserved; /* a measurement has changed the values for a while */
    uint16_t request; /* offset of the request in servo_t, bytes */
} storage_board_t;

/* Check both copies and load the stored values; before config_blocks_begin. */
void storage_begin(storage_t *storage, storage_status_t *status, const storage_board_t *board);

/* Check a write to the request. A request with the token of the last one is accepted without effect, because its
 * answer may have been lost. `whole`: the write has no mask. */
bool storage_accept(storage_t *storage, storage_status_t *status, const storage_board_t *board, uint16_t offset,
                    bool whole, const uint8_t *data, uint16_t size);

/* Note that a value that is stored has changed: a parameter was written, or a block taken. */
static inline void storage_note_change(storage_t *storage) { storage->changed = true; }

/* True while a flash command is in progress: the data flash, which contains the tables of the server, must not be
 * read. */
static inline bool storage_busy(const storage_t *storage, hal_t *hal)
{
    return storage->running && hal_flash_result(hal) == HAL_FLASH_BUSY;
}

/* Evaluate the completed flash command and begin the next one; not while a command is in progress. */
void storage_step(storage_t *storage, storage_status_t *status, const storage_board_t *board);

#endif

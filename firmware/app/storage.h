/* storage.h - parameters and configuration that outlive power: two copies in the data flash, written in turn.
 *
 * A save writes the copy that is not needed: the other one stays what it is until the new one has its seal. So power may
 * fail at any instant, and the board comes up with the old set or with the new one. At the reset the newest intact copy
 * that fits this firmware is taken over before the axes are set up; without one the built-in values are.
 *
 * All of it runs in the background, one command of the flash per turn, and only while both axes are at rest with their
 * outputs off. What is stored moves and enables nothing: commands are no part of it.
 */
#ifndef SERVO_APP_STORAGE_H
#define SERVO_APP_STORAGE_H

#include "app/event_log.h"
#include "app/stored_set.h"
#include "drive/axis_data.h"

typedef struct {
    uint16_t kind;  /* STORAGE_REQUEST_ of the last accepted request .. */
    uint16_t token; /* .. and its token; 0: there was none */
    uint16_t copy;  /* that is written or erased .. */
    uint16_t step;  /* .. and how many of its commands are done */
    uint16_t kept;  /* the copy that stays; STORAGE_COPIES: none is worth it */
    uint16_t taken; /* config_status_t.taken_count when the save began */
    bool running;   /* a command is under way, or has not been looked at yet */
    bool changed;   /* a parameter was written meanwhile */
    uint32_t word;  /* that is being programmed */
    uint32_t crc;   /* of the words before it */
} storage_t;

/* What it works on. */
typedef struct {
    hal_t *hal;
    const axis_t *axes;
    stored_values_t values;
    const config_status_t *config_status;
    event_log_t *event_log;
    uint16_t request; /* of the host's request, in servo_t */
} storage_board_t;

/* Look at both copies and take over what is stored; before config_blocks_begin. */
void storage_begin(storage_t *storage, storage_status_t *status, const storage_board_t *board);

/* Is this write of a part of the request acceptable? A request with the token of the last one is accepted and changes
 * nothing: its answer may have been lost. `whole` says that no mask leaves anything out. */
bool storage_accept(storage_t *storage, storage_status_t *status, const storage_board_t *board, uint16_t offset,
                    bool whole, const uint8_t *data, uint16_t size);

/* The host has written a parameter. */
static inline void storage_note_parameter(storage_t *storage) { storage->changed = true; }

/* A command of the flash is under way: nothing may read the data flash, in which the tables of the server lie. */
static inline bool storage_busy(const storage_t *storage, hal_t *hal)
{
    return storage->running && hal_flash_result(hal) == HAL_FLASH_BUSY;
}

/* Look at the command that has ended, and begin the next one. Not while it is busy. */
void storage_step(storage_t *storage, storage_status_t *status, const storage_board_t *board);

#endif

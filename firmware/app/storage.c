#include "app/storage.h"

#include "drive/take_config.h"
#include "math/crc32.h"

#define NO_COPY STORAGE_COPIES

/* ---- selection of the copy ------------------------------------------------------------------------------------------ */

static bool is_newer(uint32_t sequence, uint32_t other) { return (int32_t)(sequence - other) > 0; }

/* Rank of a copy in this state (stored_copy_t): 2 intact; 1 complete, but of another layout or out of range; 0
 * unusable. */
static uint16_t copy_rank(uint16_t state)
{
    switch ((stored_copy_t)state) {
    case STORED_COPY_INTACT:
        return 2;
    case STORED_COPY_OTHER_LAYOUT:
    case STORED_COPY_OUT_OF_RANGE:
        return 1;
    default:
        return 0;
    }
}

/* Examine both copies and keep the better one, or the newer one of two equal ones. */
static void examine_copies(storage_t *storage, storage_status_t *status, const storage_board_t *board)
{
    uint32_t sequence[STORAGE_COPIES];
    storage->kept = NO_COPY;
    status->sequence = 0;
    for (uint16_t i = 0; i < STORAGE_COPIES; i++) {
        status->copy[i] = (uint16_t)stored_check(board->hal, i, &board->values, &sequence[i]);
        const uint16_t kept = storage->kept;
        const uint16_t before = (kept != NO_COPY) ? copy_rank(status->copy[kept]) : 0U;
        const uint16_t now = copy_rank(status->copy[i]);
        if (now > before || (now == before && now != 0U && is_newer(sequence[i], sequence[kept]))) {
            storage->kept = i;
        }
        if (now != 0U && is_newer(sequence[i], status->sequence)) {
            status->sequence = sequence[i];
        }
    }
}

static uint16_t other_copy(uint16_t copy) { return (copy == 0U) ? 1U : 0U; }

void storage_begin(storage_t *storage, storage_status_t *status, const storage_board_t *board)
{
    *storage = (storage_t){.kept = NO_COPY};
    *status = (storage_status_t){.copy = {STORED_COPY_ABSENT, STORED_COPY_ABSENT}};
    if (!hal_flash_present(board->hal)) {
        return;
    }
    examine_copies(storage, status, board);
    for (uint16_t i = 0; i < STORAGE_COPIES; i++) {
        if (status->copy[i] != STORED_COPY_EMPTY && status->copy[i] != STORED_COPY_INTACT) {
            event_log_copy(board->event_log, i, status->copy[i]);
        }
    }
    if (storage->kept != NO_COPY && status->copy[storage->kept] == STORED_COPY_INTACT) {
        stored_load(board->hal, storage->kept, &board->values);
        status->source = (uint16_t)(STORAGE_SOURCE_COPY_A + storage->kept);
    }
}

/* ---- requests ------------------------------------------------------------------------------------------------------- */

static bool at_rest(const axis_t *axes)
{
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        if (!axis_takes_any_config(&axes[i]) || axes[i].enable_requested) {
            return false;
        }
    }
    return true;
}

static uint16_t pair(const uint8_t *data) { return (uint16_t)((data[0] & 0xFFU) | (data[1] & 0xFFU) << 8U); }

/* The copy that is erased last. */
static uint16_t last_copy(const storage_t *storage) { return (storage->kept == NO_COPY) ? 1U : storage->kept; }

static void begin(storage_t *storage, storage_status_t *status)
{
    storage->step = 0;
    storage->changed = false;
    storage->crc = CRC32_START;
    storage->copy = other_copy(last_copy(storage));
    status->state = (uint16_t)((storage->kind == STORAGE_REQUEST_SAVE) ? STORAGE_STATE_SAVING : STORAGE_STATE_ERASING);
}

static storage_refusal_t take_request(storage_t *storage, storage_status_t *status, const storage_board_t *board,
                                      uint16_t kind, uint16_t token)
{
    if ((kind != STORAGE_REQUEST_SAVE && kind != STORAGE_REQUEST_FACTORY) || token == 0U || token == storage->token) {
        return STORAGE_REFUSAL_FORM;
    }
    if (status->copy[0] == STORED_COPY_ABSENT) {
        return STORAGE_REFUSAL_ABSENT;
    }
    if (status->state != STORAGE_STATE_IDLE || board->reserved) {
        return STORAGE_REFUSAL_BUSY;
    }
    if (!at_rest(board->axes)) {
        return STORAGE_REFUSAL_MOTION;
    }
    storage->kind = kind;
    storage->token = token;
    begin(storage, status);
    return STORAGE_REFUSAL_NONE;
}

bool storage_accept(storage_t *storage, storage_status_t *status, const storage_board_t *board, uint16_t offset,
                    bool whole, const uint8_t *data, uint16_t size)
{
    const bool formed = whole && offset == 0U && size == sizeof(storage_request_t);
    const uint16_t kind = formed ? pair(data) : 0U;
    const uint16_t token = formed ? pair(data + sizeof(uint16_t)) : 0U;
    if (token != 0U && token == storage->token && kind == storage->kind) {
        return true;
    }
    status->refusal = (uint16_t)take_request(storage, status, board, kind, token);
    return status->refusal == STORAGE_REFUSAL_NONE;
}

/* ---- commands of the flash ------------------------------------------------------------------------------------------ */

/* Number of flash commands for the copy in progress: a save erases its sectors and programs its words; a return to the
 * built-in values erases the sectors of both copies, one copy at a time. */
static uint16_t steps(const storage_t *storage)
{
    return (uint16_t)((storage->kind == STORAGE_REQUEST_SAVE) ? STORED_SECTORS + STORED_WORDS : STORED_SECTORS);
}

static bool erases(const storage_t *storage) { return storage->step < STORED_SECTORS; }

static uint16_t sector_of(const storage_t *storage)
{
    return (uint16_t)(storage->copy * STORED_SECTORS + storage->step);
}

static uint16_t place_of(const storage_t *storage)
{
    return stored_place(storage->copy, (uint16_t)(storage->step - STORED_SECTORS));
}

static void start(storage_t *storage, const storage_status_t *status, const storage_board_t *board)
{
    storage->running = true;
    if (erases(storage)) {
        hal_flash_erase(board->hal, sector_of(storage));
        return;
    }
    const uint16_t index = (uint16_t)(storage->step - STORED_SECTORS);
    if (index == STORED_CHECKSUM) {
        storage->word = crc32_end(storage->crc);
    } else {
        storage->word = stored_word(&board->values, status->sequence + 1U, index);
        storage->crc = crc32_add(storage->crc, storage->word, 4);
    }
    hal_flash_program(board->hal, place_of(storage), storage->word);
}

/* True if the command had the intended effect. */
static bool is_done(const storage_t *storage, const storage_board_t *board)
{
    if (hal_flash_result(board->hal) != HAL_FLASH_DONE) {
        return false;
    }
    if (!erases(storage)) {
        return hal_flash_read(board->hal, place_of(storage)) == storage->word;
    }
    const uint16_t first = (uint16_t)(sector_of(storage) * HAL_FLASH_SECTOR_WORDS);
    for (uint16_t i = 0; i < HAL_FLASH_SECTOR_WORDS; i++) {
        if (hal_flash_read(board->hal, (uint16_t)(first + i)) != HAL_FLASH_ERASED) {
            return false;
        }
    }
    return true;
}

static void finish(storage_t *storage, storage_status_t *status, const storage_board_t *board,
                   storage_refusal_t refusal)
{
    examine_copies(storage, status, board);
    status->refusal = (uint16_t)refusal;
    status->answered = storage->token;
    status->state = STORAGE_STATE_IDLE;
    if (refusal != STORAGE_REFUSAL_NONE) {
        event_log_refused(board->event_log, board->request);
    } else if (storage->kind == STORAGE_REQUEST_SAVE) {
        status->saves++;
    }
}

/* Erase the other copy next. The kept copy is erased last: until then a reset restores it. */
static bool continue_with_other_copy(storage_t *storage)
{
    if (storage->kind == STORAGE_REQUEST_SAVE || storage->copy == last_copy(storage)) {
        return false;
    }
    storage->copy = last_copy(storage);
    storage->step = 0;
    return true;
}

void storage_step(storage_t *storage, storage_status_t *status, const storage_board_t *board)
{
    if (status->state == STORAGE_STATE_IDLE) {
        return;
    }
    if (storage->running) {
        storage->running = false;
        if (!is_done(storage, board)) {
            finish(storage, status, board, STORAGE_REFUSAL_FLASH);
            return;
        }
        storage->step++;
    }
    if (storage->step == steps(storage) && !continue_with_other_copy(storage)) {
        finish(storage, status, board, STORAGE_REFUSAL_NONE);
    } else if (!at_rest(board->axes)) {
        finish(storage, status, board, STORAGE_REFUSAL_MOTION);
    } else if (storage->changed && storage->kind == STORAGE_REQUEST_SAVE) {
        /* the copy would hold a set of values that was never in force */
        finish(storage, status, board, STORAGE_REFUSAL_CHANGED);
    } else {
        start(storage, status, board);
    }
}

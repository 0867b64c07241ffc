/* The state of a board as an image: struct board but its gaps, with every pointer relative, then the bytes in use of its ring
 * buffers. */
#include "board_parts.h"

#include <string.h>

#define MAGIC UINT64_C(0x5453445242565253) /* "SRVBRDST" */
#define PRIME UINT64_C(0x9E3779B97F4A7C15)
#define LANES 4u

typedef struct {
    uint64_t magic;
    uint64_t build; /* identity of the library that has written the image */
    uint64_t size; /* of the whole image [bytes] */
    uint64_t check; /* sum of the rest */
} header_t;

/* ---- identity and check sum ----------------------------------------------------------------------------------------- */

/* Pointers to the code and the tables of the library are relative to this object. */
static const char anchor = 0;

static uint64_t distance(uintptr_t address) { return (uint64_t)(address - (uintptr_t)&anchor); }

/* Sources, compiler and options, and some distances: a link with other ones has moved what the pointers lead to. */
static uint64_t build_identity(const board_t *board)
{
    uint64_t build = board_layout.build ^ board_program_identity(board);
    build = (build ^ distance((uintptr_t)&board_layout)) * PRIME;
    build = (build ^ distance((uintptr_t)board_servo_config)) * PRIME;
    return (build ^ distance((uintptr_t)board_save)) * PRIME;
}

uint64_t board_check_sum(const uint8_t *data, size_t size)
{
    uint64_t lane[LANES] = {1, 2, 3, 4};
    size_t at = 0;
    for (; at + sizeof lane <= size; at += sizeof lane) {
        uint64_t word[LANES];
        memcpy(word, data + at, sizeof word);
        for (size_t k = 0; k < LANES; k++) {
            lane[k] = (lane[k] ^ word[k]) * PRIME;
            lane[k] ^= lane[k] >> 29;
        }
    }
    uint64_t rest[LANES] = {0};
    memcpy(rest, data + at, size - at);
    uint64_t sum = size;
    for (size_t k = 0; k < LANES; k++) {
        sum = (sum ^ lane[k] ^ rest[k]) * PRIME;
        sum ^= sum >> 32;
    }
    return sum;
}

/* ---- pointers ------------------------------------------------------------------------------------------------------- */

/* A pointer in an image: 0, one more than its distance from the board, or LIBRARY plus its distance from the anchor. */
#define LIBRARY (UINT64_C(1) << 62)

typedef char pointers_fit_t[(sizeof(uintptr_t) == sizeof(uint64_t)) ? 1 : -1];

static uint64_t relative(const board_t *board, uint64_t pointer)
{
    const uint64_t in_board = pointer - (uintptr_t)board;
    return (pointer == 0) ? 0 : (in_board <= board_layout.size) ? in_board + 1u : LIBRARY + distance(pointer);
}

static uint64_t absolute(const board_t *board, uint64_t image)
{
    return (image == 0)                        ? 0
           : (image <= board_layout.size + 1u) ? (uintptr_t)board + image - 1u
                                               : (uintptr_t)&anchor + (image - LIBRARY);
}

static void convert(const board_t *board, uint8_t *place, uint64_t (*conversion)(const board_t *, uint64_t))
{
    uint64_t pointer;
    memcpy(&pointer, place, sizeof pointer);
    pointer = conversion(board, pointer);
    memcpy(place, &pointer, sizeof pointer);
}

/* In a copy of the board without its gaps; the pointers in these stay. */
static void make_relative(const board_t *board, uint8_t *copy)
{
    const board_gap_t *gap = board_layout.gap;
    const board_gap_t *end = gap + board_layout.gaps;
    size_t left_out = 0;
    for (size_t k = 0; k < board_layout.pointers; k++) {
        const size_t offset = board_layout.pointer[k];
        for (; gap < end && gap->offset + gap->size <= offset; gap++) {
            left_out += gap->size;
        }
        if (gap == end || offset < gap->offset) {
            convert(board, copy + offset - left_out, relative);
        }
    }
}

static void make_absolute(board_t *board)
{
    const board_gap_t *gap = board_layout.gap;
    const board_gap_t *end = gap + board_layout.gaps;
    for (size_t k = 0; k < board_layout.pointers; k++) {
        const size_t offset = board_layout.pointer[k];
        while (gap < end && gap->offset + gap->size <= offset) {
            gap++;
        }
        if (gap == end || offset < gap->offset) {
            convert(board, (uint8_t *)board + offset, absolute);
        }
    }
}

/* ---- parts ---------------------------------------------------------------------------------------------------------- */

typedef enum { TO_IMAGE, TO_BOARD } direction_t;

static uint8_t *copy_part(uint8_t *board, uint8_t *image, size_t size, direction_t direction)
{
    memcpy((direction == TO_IMAGE) ? image : board, (direction == TO_IMAGE) ? board : image, size);
    return image + size;
}

static size_t number_at(const board_t *board, size_t offset)
{
    size_t number;
    memcpy(&number, (const uint8_t *)board + offset, sizeof number);
    return number;
}

static size_t used(const board_t *board, const board_gap_t *gap)
{
    return (gap->ring_used != 0) ? number_at(board, gap->ring_used) : 0u;
}

static uint8_t *copy_without_gaps(board_t *board, uint8_t *image, direction_t direction)
{
    size_t begin = 0;
    for (size_t k = 0; k < board_layout.gaps; k++) {
        const board_gap_t *gap = &board_layout.gap[k];
        image = copy_part((uint8_t *)board + begin, image, gap->offset - begin, direction);
        begin = gap->offset + gap->size;
    }
    return copy_part((uint8_t *)board + begin, image, board_layout.size - begin, direction);
}

static void copy_rings(board_t *board, uint8_t *image, direction_t direction)
{
    for (size_t k = 0; k < board_layout.gaps; k++) {
        const board_gap_t *gap = &board_layout.gap[k];
        const size_t size = used(board, gap);
        if (size > 0) {
            const size_t head = number_at(board, gap->ring_head);
            const size_t first = (size < gap->size - head) ? size : gap->size - head;
            uint8_t *ring = (uint8_t *)board + gap->offset;
            image = copy_part(ring + head, image, first, direction);
            image = copy_part(ring, image, size - first, direction);
        }
    }
}

/* ---- board.h -------------------------------------------------------------------------------------------------------- */

const char *board_save(board_t *board, uint8_t *image, size_t room, size_t *size)
{
    *size = 0;
    const char *problem = board_rest(board);
    if (problem != NULL) {
        return problem;
    }
    const servo_t *servo = board_servo(board);
    const board_sampler_t *sampler = board_sampler(board);
    if ((sampler != NULL) ? sampler->samples != NULL : servo->freemaster.samples.samples != servo->samples) {
        return "a recorder samples into memory of the host; end the sampling first";
    }
    *size = sizeof(header_t) + board_layout.size;
    for (size_t k = 0; k < board_layout.gaps; k++) {
        *size = *size - board_layout.gap[k].size + used(board, &board_layout.gap[k]);
    }
    if (*size > room) {
        return NULL;
    }
    uint8_t *body = image + sizeof(header_t);
    uint8_t *rings = copy_without_gaps(board, body, TO_IMAGE);
    make_relative(board, body);
    copy_rings(board, rings, TO_IMAGE);
    const header_t header = {MAGIC, build_identity(board), *size, board_check_sum(body, *size - sizeof header)};
    memcpy(image, &header, sizeof header);
    return NULL;
}

const char *board_restore(board_t *board, const uint8_t *image, size_t size)
{
    header_t header = {0};
    memcpy(&header, image, (size < sizeof header) ? size : sizeof header);
    if (size < sizeof header || header.magic != MAGIC) {
        return "this is not the state of a board";
    }
    if (header.build != build_identity(board)) {
        return "the state is from another build or level of the board, or another program; only what saved it can continue it";
    }
    uint8_t *body = (uint8_t *)image + sizeof header; /* only read */
    if (header.size != size || header.check != board_check_sum(body, size - sizeof header)) {
        return "the state is incomplete or damaged";
    }
    uint8_t *rings = copy_without_gaps(board, body, TO_BOARD);
    copy_rings(board, rings, TO_BOARD);
    make_absolute(board);
    board_restored(board);
    return NULL;
}

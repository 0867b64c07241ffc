#include "app/points.h"

#include <stddef.h>

#include "app/words.h"
#include "drive/limits.h"
#include "drive/motion.h"

/* Words of a point: tick; position [counts]; speed; i_q in the low half, then 12 fraction bits of a count, the axis,
 * and a flag: replace the queued points from this tick on. */
#define PART_SHIFT 16U
#define PART_MASK UINT32_C(0xFFF)
#define AXIS_BIT UINT32_C(0x10000000)
#define REPLACE_BIT UINT32_C(0x20000000)
#define RESERVED_BITS UINT32_C(0xC0000000)
#define POINT_BYTES (4U * POINT_WORDS)
/* PWM periods after the snapshot: a point queued before +8 is used from +16 on, in a segment that begins at +8 and
 * takes HERMITE_DURATION_MIN (16) or longer */
#define LEAD UINT32_C(24)

typedef struct {
    trajectory_point_t point;
    uint16_t axis;
    bool replace;
    bool valid;
} record_t;

static record_t record_of(const uint32_t words[POINT_WORDS])
{
    const uint32_t last = words[3];
    return (record_t){
        .point = {words[0], (int32_t)words[1], (frac32_t)words[2], (frac16_t)(uint16_t)(last & UINT32_C(0xFFFF)),
                  (uint16_t)((last >> PART_SHIFT) & PART_MASK)},
        .axis = (uint16_t)((last & AXIS_BIT) != 0U),
        .replace = (last & REPLACE_BIT) != 0U,
        .valid = (last & RESERVED_BITS) == 0U,
    };
}

static record_t record_at(const uint8_t *data)
{
    uint32_t words[POINT_WORDS];
    for (uint16_t k = 0; k < POINT_WORDS; k++) {
        words[k] = word_at(data + (uint16_t)(4U * k));
    }
    return record_of(words);
}

/* ---- checks --------------------------------------------------------------------------------------------------------- */

/* The state in which the segment to the next point begins. */
typedef struct {
    uint32_t tick;
    hermite_state_t state;
    uint16_t waiting;
} place_t;

static place_t place_of(const points_board_t *board, const record_t *record)
{
    const axis_t *axis = &board->axes[record->axis];
    const trajectory_t *t = &axis->trajectory;
    const uint32_t end = (t->in != t->out) ? t->point[(t->in - 1U) % TRAJECTORY_POINTS].tick + 1U : t->end.tick + 1U;
    const trajectory_point_t *before = trajectory_before(t, record->replace ? record->point.tick : end);
    const path_position_t here = path_counts(board->snapshot->axis[record->axis].position_ref);
    place_t place = {board->snapshot->tick, {here, 0}, trajectory_waiting(t)};
    if (record->replace) {
        while (place.waiting > 0U &&
               (int32_t)(t->point[(t->out + place.waiting - 1U) % TRAJECTORY_POINTS].tick - record->point.tick) >= 0) {
            place.waiting--;
        }
    }
    if (before == NULL) {
        place.state.step = path_step_of(axis->config, axis->motion.shaped_speed);
    } else {
        place.tick = before->tick;
        place.state.step = path_step_of(axis->config, before->speed);
        place.state.position = trajectory_position(before, here);
    }
    return place;
}

static point_refusal_t check_segment(const axis_t *axis, const hermite_t *segment, path_position_t from)
{
    path_position_t min, max;
    if (!hermite_speed_within(segment, axis->path_limits.step)) {
        return POINT_REFUSAL_SPEED;
    }
    if (!hermite_acceleration_within(segment, axis->path_limits.acceleration)) {
        return POINT_REFUSAL_ACCELERATION;
    }
    hermite_reach(segment, &min, &max);
    const axis_limits_t limits = limits_at_switches(axis, axis->written_limits);
    /* from outside of the limits a segment may lead towards them */
    const bool below = min < 0 && from + min < path_counts(limits.position_min);
    const bool above = max > 0 && from + max > path_counts(limits.position_max);
    const bool given = limits.position_min != INT32_MIN || limits.position_max != INT32_MAX;
    return (given && (below || above)) ? POINT_REFUSAL_POSITION : POINT_REFUSAL_NONE;
}

/* Check the next point of an axis; on success `place` becomes that point. */
static point_refusal_t check_point(const axis_t *axis, const record_t *record, place_t *place, uint32_t now)
{
    const trajectory_point_t *point = &record->point;
    const uint32_t duration = point->tick - place->tick;
    const hermite_state_t to = {trajectory_position(point, place->state.position),
                                path_step_of(axis->config, point->speed)};
    const path_position_t distance = to.position - place->state.position;
    hermite_t segment;
    if ((int32_t)(point->tick - now) < (int32_t)LEAD) {
        return POINT_REFUSAL_PAST;
    }
    if ((int32_t)duration <= 0) {
        return POINT_REFUSAL_ORDER;
    }
    if (duration < HERMITE_DURATION_MIN || duration > HERMITE_DURATION_MAX) {
        return POINT_REFUSAL_DURATION;
    }
    if (distance > HERMITE_DISTANCE_MAX || distance < -HERMITE_DISTANCE_MAX) {
        return POINT_REFUSAL_SPEED;
    }
    hermite_set(&segment, place->state, to, duration);
    const point_refusal_t refusal = check_segment(axis, &segment, place->state.position);
    place->tick = point->tick;
    place->state = to;
    place->waiting++;
    return (refusal == POINT_REFUSAL_NONE && place->waiting > TRAJECTORY_POINTS) ? POINT_REFUSAL_FULL : refusal;
}

point_refusal_t points_check(const points_board_t *board, const uint8_t *data, uint16_t size)
{
    place_t places[HAL_AXES];
    bool begun[HAL_AXES] = {false};
    if (board->pending) {
        return POINT_REFUSAL_BUSY;
    }
    if (size == 0U || size % POINT_BYTES != 0U) {
        return POINT_REFUSAL_FORM;
    }
    if (board->measuring && size > POINTS_MEASURING * POINT_BYTES) {
        return POINT_REFUSAL_MEASUREMENT;
    }
    for (uint16_t at = 0; at < size; at = (uint16_t)(at + POINT_BYTES)) {
        const record_t record = record_at(data + at);
        const axis_t *axis = &board->axes[record.axis];
        place_t *place = &places[record.axis];
        if (!record.valid || (record.replace && begun[record.axis])) {
            return POINT_REFUSAL_FORM;
        }
        if (!motion_takes_points(axis)) {
            return POINT_REFUSAL_MODE;
        }
        if (!begun[record.axis]) {
            *place = place_of(board, &record);
            begun[record.axis] = true;
        }
        const point_refusal_t refusal = check_point(axis, &record, place, board->snapshot->tick);
        if (refusal != POINT_REFUSAL_NONE) {
            return refusal;
        }
    }
    return POINT_REFUSAL_NONE;
}

uint16_t points_queue(axis_t *axes, const command_block_t *block, uint16_t count)
{
    uint16_t mask = 0;
    for (uint16_t i = 0; i < count; i++) {
        uint32_t words[POINT_WORDS];
        for (uint16_t k = 0; k < POINT_WORDS; k++) {
            words[k] = (uint32_t)block->memory.points[i * POINT_WORDS + k];
        }
        const record_t record = record_of(words);
        trajectory_put(&axes[record.axis].trajectory, record.point, record.replace);
        mask = (uint16_t)(mask | 1U << record.axis);
    }
    return mask;
}

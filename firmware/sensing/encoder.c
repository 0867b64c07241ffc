#include "sensing/encoder.h"

#include "config/contract_gen.h"

int16_t encoder_count_at(const encoder_config_t *config, frac16_t theta_e)
{
    const int32_t scaled = (int32_t)theta_e * (4 * (int32_t)encoder_lines(config)) / config->pole_pairs;
    const int32_t count = asr32(scaled + INT32_C(0x8000), 16);
    return (count > INT16_MAX) ? INT16_MAX : (count < -INT16_MAX) ? -INT16_MAX : (int16_t)count;
}

/* Difference of two counts, wrapped to plus or minus half a period. */
static int32_t wrapped(int32_t counts, int32_t difference)
{
    const int32_t half = counts / 2;
    /* At most one pass for consecutive samples of a turning shaft; any two counts differ by less than two periods. */
    while (difference > half) {
        difference -= counts;
    }
    while (difference < -half) {
        difference += counts;
    }
    return difference;
}

int16_t encoder_difference(const encoder_config_t *config, uint16_t count, uint16_t previous)
{
    return (int16_t)wrapped(config->counts, (int32_t)(int16_t)count - (int16_t)previous);
}

void encoder_reset(encoder_t *encoder, uint16_t count, uint16_t index)
{
    encoder->count = count;
    encoder->index = index;
    encoder->pending = 0;
    encoder->half_turns = 0;
    encoder->turns = 0;
    encoder->count_init = (int16_t)count;
    encoder->position = 0;
    encoder->integral = 0;
}

/* RealZCnt turns and the counter, in counts. */
static int32_t counts_of(const encoder_t *encoder, uint16_t period, uint16_t count)
{
    const uint32_t whole = (uint32_t)encoder->turns * period;
    return i32_add_wrap((int32_t)whole, (int16_t)count);
}

bool encoder_update(encoder_t *encoder, const encoder_config_t *config, uint16_t count, uint16_t index)
{
    const uint16_t period = config->counts;
    const int32_t raw = (int32_t)(int16_t)count - (int16_t)encoder->count;
    const int32_t moved = wrapped(period, raw);

    /* F14, except that an index pulse counts only together with the wrap that it announces: the shaft may reach the
     * compare value and turn back. */
    encoder->pending = (uint16_t)(encoder->pending + (uint16_t)(index - encoder->index));
    if (raw != moved) {
        if (encoder->pending != 0U) {
            /* not the sign of moved: a shaft that turns back may stand still across the wrap */
            encoder->turns = i32_add_wrap(encoder->turns, (raw < 0) ? 1 : -1);
        }
        encoder->pending = 0;
        encoder->half_turns ^= 1U;
    } else if (encoder->pending != 0U) {
        const int32_t half = period / 2;
        const int32_t from_zero = (int16_t)count;
        if (from_zero < half && from_zero > -half) {
            encoder->pending = 0; /* far from the compare values: the shaft turned back */
        }
    }
    encoder->count = count;
    encoder->index = index;
    encoder->integral = i32_add_wrap(encoder->integral, moved);

    /* E41 in counts */
    encoder->position = i32_sub_wrap(counts_of(encoder, period, count), encoder->count_init);
    return encoder->position == encoder->integral;
}

void encoder_resync(encoder_t *encoder, const encoder_config_t *config)
{
    encoder->count_init = i32_sub_wrap(counts_of(encoder, config->counts, encoder->count), encoder->integral);
    encoder->position = encoder->integral;
    encoder->pending = 0;
}

void encoder_preset(encoder_t *encoder, const encoder_config_t *config, uint16_t count)
{
    encoder->count_init = i32_sub_wrap(counts_of(encoder, config->counts, count), encoder->position);
    encoder->count = count;
    encoder->pending = 0;
    encoder->half_turns = 0;
}

/* The remainder is exact; the reciprocal of the lines decides only between two neighbours, within 1/64 of the middle. */
void encoder_position_add(encoder_position_t *position, const encoder_config_t *config, int16_t counts)
{
    const int32_t parts = (int32_t)counts * (POSITION_PER_TURN / 4) + position->rest;
    const int64_t scaled = (int64_t)parts * (int32_t)config->angle_per_count;
    const int32_t whole = (int32_t)asr64(scaled + (INT32_C(1) << 29), 30);
    position->whole = i32_add_wrap(position->whole, whole);
    position->rest = (int16_t)(uint16_t)((uint32_t)parts - (uint32_t)whole * position->lines);
}

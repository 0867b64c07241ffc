#include "drive/brake.h"

#define RESTED (FRAC32_MAX / 2) /* a spent resistor is used again when it has cooled so far */
#define LEAD_TICKS 4

void brake_init(brake_t *brake) { *brake = (brake_t){.regen_derating = FRAC16_MAX}; }

/* Energy in, u^2 / R while it is on; a steady power out. */
static void heat_up(brake_t *brake, const brake_config_t *config, frac16_t u_dc)
{
    const frac32_t burnt = brake->on ? f32_gain(f32_mul16(u_dc, u_dc), config->heating) : 0;
    const frac32_t heat = f32_add(brake->heat, f32_sub(burnt, config->cooling));
    brake->heat = (heat > 0) ? heat : 0;
    if (brake->heat >= FRAC32_MAX - config->cooling) {
        brake->spent = true;
    } else if (brake->heat <= RESTED) {
        brake->spent = false;
    }
}

/* Where a rising bus will be when a current that is changed now has changed: filter, tick and current loop are late by some
 * two milliseconds. */
static frac16_t ahead(const brake_t *brake, frac16_t u_dc)
{
    const int32_t rise = (int32_t)u_dc - brake->u_dc;
    return (rise > 0) ? sat16(u_dc + LEAD_TICKS * rise) : u_dc;
}

/* All below `start`, nothing from `full` on, a straight line between. */
static frac16_t derating_at(const brake_config_t *config, frac16_t u_dc)
{
    if (u_dc <= config->start) {
        return FRAC16_MAX;
    }
    if (u_dc >= config->full) {
        return 0;
    }
    return (frac16_t)((int32_t)(config->full - u_dc) * FRAC16_MAX / (config->full - config->start));
}

void brake_step(brake_t *brake, const brake_config_t *config, bool fitted, frac16_t u_dc)
{
    heat_up(brake, config, u_dc);
    brake->able = fitted && !brake->spent;
    const bool wanted = brake->on ? u_dc > config->off : u_dc >= config->on;
    brake->on = wanted && brake->able;
    brake->regen_derating = derating_at(config, ahead(brake, u_dc));
    brake->u_dc = u_dc;
}

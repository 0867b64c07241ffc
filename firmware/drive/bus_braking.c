#include "drive/bus_braking.h"

#define RESTED (FRAC32_MAX / 2) /* the resistor is enabled again after cooling to this heat */
#define LEAD_TICKS 4 /* slow ticks: 2 ms */

void bus_braking_init(bus_braking_t *braking) { *braking = (bus_braking_t){.regen_derating = FRAC16_MAX}; }

/* Thermal model: input u^2 / R while the resistor is on, constant output power. */
static void heat_up(bus_braking_t *braking, const bus_braking_config_t *config, frac16_t u_dc)
{
    const frac32_t burnt = braking->on ? f32_gain(f32_mul16(u_dc, u_dc), config->heating) : 0;
    const frac32_t heat = f32_add(braking->heat, f32_sub(burnt, config->cooling));
    braking->heat = (heat > 0) ? heat : 0;
    if (braking->heat >= FRAC32_MAX - config->cooling) {
        braking->exhausted = true;
    } else if (braking->heat <= RESTED) {
        braking->exhausted = false;
    }
}

/* Prediction of a rising bus voltage at the time at which a current changed now takes effect: filter, tick and current
 * loop cause a delay of about two milliseconds. */
static frac16_t ahead(const bus_braking_t *braking, frac16_t u_dc)
{
    const int32_t rise = (int32_t)u_dc - braking->u_dc;
    return (rise > 0) ? sat16(u_dc + LEAD_TICKS * rise) : u_dc;
}

/* 1 below `start`, 0 from `full` on, linear in between. */
static frac16_t derating_at(const bus_braking_config_t *config, frac16_t u_dc)
{
    if (u_dc <= config->start) {
        return FRAC16_MAX;
    }
    if (u_dc >= config->full) {
        return 0;
    }
    return (frac16_t)((int32_t)(config->full - u_dc) * FRAC16_MAX / (config->full - config->start));
}

void bus_braking_step(bus_braking_t *braking, const bus_braking_config_t *config, bool fitted, frac16_t u_dc)
{
    heat_up(braking, config, u_dc);
    braking->available = fitted && !braking->exhausted;
    const bool requested = braking->on ? u_dc > config->off : u_dc >= config->on;
    braking->on = requested && braking->available;
    braking->regen_derating = derating_at(config, ahead(braking, u_dc));
    braking->u_dc = u_dc;
}

#include "drive/heat_watch.h"

#define HOT_TICKS 16 /* 8 ms: a heat sink is never quicker, noise is */

void heat_watch_start(heat_watch_t *watch) { *watch = (heat_watch_t){0}; }

void heat_watch_step(heat_watch_t *watch, const heat_watch_config_t *config, uint16_t code)
{
    const bool rising = config->hot > config->cool;
    const bool beyond = rising ? code >= config->hot : code <= config->hot;
    const bool cool = rising ? code < config->cool : code > config->cool;
    watch->ticks = beyond ? (uint16_t)(watch->ticks + 1U) : 0U;
    if (watch->ticks >= HOT_TICKS) {
        watch->hot = true;
        watch->ticks = HOT_TICKS;
    } else if (cool) {
        watch->hot = false;
    }
}

#include "plant/switching_schedule.h"

bool switching_take(switching_t *plant, switching_event_t *event)
{
    if (plant->pending == 0u) {
        return false;
    }
    *event = plant->event[plant->first];
    plant->first = (plant->first + 1u) % SWITCHING_EVENTS;
    plant->pending--;
    return true;
}

void switching_update_other_clock(switching_t *plant)
{
    plant->other_clock = plant->window_clock;
    if (!plant->shaft[0].fine && !plant->shaft[1].fine) {
        plant->shaft_clock = NEVER;
    } else if (plant->shaft_clock == NEVER) {
        plant->shaft_clock = plant->now + 1u;
    }
    plant->other_clock = earlier(plant->other_clock, plant->shaft_clock);
    for (int i = 0; i < BOARD_AXES; i++) {
        if (plant->axis[i].short_clock > plant->now) {
            plant->other_clock = earlier(plant->other_clock, plant->axis[i].short_clock);
        }
        for (int line = 0; line < QUADRATURE_LINES; line++) {
            plant->other_clock = earlier(plant->other_clock, plant->axis[i].glitch_clock[line]);
        }
        plant->other_clock = earlier(plant->other_clock, plant->axis[i].slip_clock);
    }
}

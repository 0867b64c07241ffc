#include "plant/switching.h"

#include <string.h>

#include "plant/switching_axis.h"
#include "plant/switching_parameters.h"
#include "plant/switching_periodic.h"

void switching_init(switching_t *plant, const board_config_t *config)
{
    memset(plant, 0, sizeof *plant);
    plant->stale = true;
    supply_init(&plant->supply, &config->bus, config->ambient);
    switching_apply_bus(plant, &config->bus);
    plant_random_init(&plant->noise, config->seed, 0);
    plant->window = (uint64_t)(SWITCHING_CLOCK_HZ / config->pwm_frequency + 0.5);
    plant->window_clock = plant->window;
    plant->other_clock = plant->window;
    plant->shaft_clock = NEVER;
    for (int i = 0; i < BOARD_AXES; i++) {
        const plant_axis_t *c = &config->axis[i];
        switching_axis_t *axis = &plant->axis[i];
        switched_inverter_init(&axis->inverter, c);
        switching_apply_axis(plant, i, config);
        axis->window = switched_inverter_integral(&axis->inverter);
        quadrature_init(&axis->encoder, c, config->seed, (uint64_t)i + 3u);
        thermal_init(&axis->winding, c->winding_capacity, c->winding_resistance, config->ambient);
        thermal_init(&axis->sink, c->sink_capacity, c->sink_resistance, config->ambient);
        plant_random_init(&axis->noise, config->seed, (uint64_t)i + 1u);
        plant_faults_init(&axis->faults, c, config->seed, (uint64_t)i + 5u);
        for (int line = 0; line < QUADRATURE_LINES; line++) {
            axis->glitch_clock[line] = NEVER;
        }
        axis->slip_clock = NEVER;
        axis->shown_clock = NEVER;
        axis->i_noise = c->i_noise;
        plant->t_magnet[i] = config->ambient;
    }
    switching_update_other_clock(plant);
}

static void process_other_events(switching_t *plant)
{
    for (int i = 0; i < BOARD_AXES; i++) {
        for (int line = 0; line < QUADRATURE_LINES; line++) {
            if (plant->axis[i].glitch_clock[line] == plant->now) {
                switching_toggle_glitch(plant, i, line);
            }
        }
        if (plant->axis[i].slip_clock == plant->now) {
            switching_slip(plant, i);
        }
        if (plant->axis[i].short_clock == plant->now) {
            switching_compare(plant, i);
        }
    }
    if (plant->window_clock == plant->now) {
        switching_end_window(plant);
    }
    if (plant->shaft_clock == plant->now) {
        switching_step_shafts(plant);
    }
    switching_update_other_clock(plant);
}

void switching_process_event(switching_t *plant)
{
    plant->now = plant->next;
    for (int i = 0; i < BOARD_AXES; i++) {
        const switching_axis_t *axis = &plant->axis[i];
        if (axis->next_clock == plant->now) {
            if (axis->report_clock == plant->now) {
                switching_pass_edge(plant, i);
            } else {
                switching_advance_axis(plant, i);
            }
        }
    }
    if (plant->other_clock == plant->now) {
        process_other_events(plant);
    }
    if (!plant->stale) {
        update_next(plant);
    }
}

/* plant.h - averaged plant: two axes on one DC bus, with their sensors. */
#ifndef PLANT_PLANT_H
#define PLANT_PLANT_H

#include <stdbool.h>
#include <stdint.h>

#include "board.h"
#include "plant/averaged_inverter.h"
#include "plant/converter.h"
#include "plant/driven_shaft.h"
#include "plant/encoder.h"
#include "plant/end_stop.h"
#include "plant/injected_faults.h"
#include "plant/motor.h"
#include "plant/motor_pair.h"
#include "plant/noise.h"
#include "plant/pins.h"
#include "plant/shaft.h"
#include "plant/supply.h"
#include "plant/thermal.h"

#define PLANT_THERMAL_STEPS 32u /* steps of the plant per step of the temperatures */
#define PLANT_SHAFT_STEPS 4 /* parts of a step for a shaft that needs shorter ones: 7.8 us at 16 kHz */

typedef struct {
    plant_axis_t config;
    averaged_inverter_t inverter;
    plant_motor_t motor;
    end_stop_t stop;
    plant_encoder_t encoder;
    plant_random_t noise;
    double codes_per_ampere; /* [1/A] */
    plant_faults_t faults;
    thermal_t sink;        /* heatsink of the inverter */
    thermal_t winding;
    plant_pins_t pins;
    shaft_t shaft;
    driven_shaft_t driven;
    double torque; /* of the air gap at the end of the last step [N m] */
    double impulse; /* its integral since power-on [N m s] */
    double t_magnet; /* [deg C] */
    bool too_fast; /* shaft_too_fast: the plant stands still from then on */
    double magnet_share; /* decay of the difference to the winding temperature per step of the temperatures, 0..1 [1] */
} plant_drive_t;

typedef struct {
    plant_drive_t axis[BOARD_AXES];
    supply_t bus;
    supply_step_t bus_step;
    double u_noise, u_noise_configured; /* standard deviation of a bus sample; without a fault [V] */
    plant_random_t bus_noise;
    motor_pair_t pair;
    double codes_per_volt; /* [1/V] */
    uint64_t step_ns; /* half a PWM period [ns] */
    double step, steps_per_second; /* step_ns in seconds [s], and its inverse [1/s] */
    double u_step; /* bus voltage at the beginning of the last step [V] */
    unsigned steps; /* steps since the last step of the temperatures */
} plant_t;

void plant_init(plant_t *plant, const board_config_t *config);

/* One step of plant->step_ns, a half cycle of the PWM, that begins at `now_ns`. */
void plant_step(plant_t *plant, uint64_t now_ns);

/* True if a shaft has been too fast: do not step the plant any more. */
static inline bool plant_too_fast(const plant_t *plant) { return plant->axis[0].too_fast || plant->axis[1].too_fast; }

/* New parameters, as board_change_plant. */
void plant_change(plant_t *plant, const board_config_t *config);

/* Present resistance of the winding in the motor's equations [ohm]. */
double plant_resistance(const plant_drive_t *axis);

/* External torque [N m], as board_set_load. */
void plant_set_load(plant_t *plant, int axis, double torque);

/* As board_drive_shaft, `late` seconds after the last step, and board_release_shaft. */
void plant_drive_shaft(plant_t *plant, int axis, double theta, double omega, double duration, double late);
void plant_release_shaft(plant_t *plant, int axis);

/* Voltages of the phases against the midpoint of the bus at the end of the last step [V]. */
void plant_voltages(const plant_t *plant, int axis, double voltage[3]);

/* True if a phase current exceeds the comparator's threshold. */
bool plant_over_current(const plant_t *plant, int axis);

/* Two phase shunts sampled at one instant. A stuck converter applies when the codes are read. */
typedef struct {
    const int *phase; /* the two phases */
    double current[2]; /* [A] */
    plant_random_t noise;
} plant_samples_t;

/* Sample the shunts of two phases at one of the two centres of the PWM. */
static inline void plant_sample(plant_t *plant, int axis, const int phase[2], bool low_side_centre,
                                plant_samples_t *samples)
{
    plant_drive_t *drive = &plant->axis[axis];
    samples->phase = phase;
    for (int k = 0; k < 2; k++) {
        samples->current[k] = averaged_inverter_shunt(&drive->inverter, &drive->motor, phase[k], low_side_centre);
    }
    samples->noise = plant_random_reserve(&drive->noise, 2);
}

/* Codes of the converters for them. */
static inline void plant_sample_codes(const plant_t *plant, int axis, const plant_samples_t *samples, uint16_t code[2])
{
    const plant_drive_t *drive = &plant->axis[axis];
    plant_random_t noise = samples->noise;
    for (int k = 0; k < 2; k++) {
        const int phase = samples->phase[k];
        const double shown =
            samples->current[k] + drive->config.i_offset[phase] + drive->config.i_noise * plant_random_gauss(&noise);
        code[k] = plant_faults_code(&drive->faults, phase, plant_code(2048.0 + shown * drive->codes_per_ampere));
    }
}

/* Converter code of the bus divider at this instant. */
uint16_t plant_bus_code(plant_t *plant);

/* Converter code of the temperature sensor of a power stage. */
uint16_t plant_sink_code(const plant_t *plant, int axis);

/* Let the holding brakes follow their coils, at the time `now` [s]. */
void plant_update_holding_brakes(plant_t *plant, double now);

/* Inject a fault, or clear it. */
void plant_set_fault(plant_t *plant, const board_fault_t *fault, bool cleared);

#endif

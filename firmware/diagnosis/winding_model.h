/* winding_model.h - temperature of a motor's winding from its currents, and the current that it bears.
 *
 *   C dT/dt = 3/2 R(T) (i_d^2 + i_q^2) - (T - T_ambient) / R_th,   R(T) = R_s (1 + 0.00393/K (T - 25 deg C))
 *
 * One heat capacity and one thermal resistance to the surroundings, whose temperature is not measured but assumed. The
 * currents are summed in every slow tick, the balance is worked out once in WINDING_TICKS.
 */
#ifndef SERVO_DIAGNOSIS_WINDING_MODEL_H
#define SERVO_DIAGNOSIS_WINDING_MODEL_H

#include "control/transforms.h"
#include "diagnosis/evidence.h"
#include "math/frac.h"

#define WINDING_TICKS 64U /* slow ticks per step, 32 ms: a power of two */

/* Temperatures are fractions of 256 deg C. */
typedef struct {
    int32_t heating;    /* rise within a step at full-scale current and 25 deg C, 32 fraction bits */
    int32_t cooling;    /* part of what it is above `ambient` that it loses within a step, 32 fraction bits */
    frac16_t ambient;   /* temperature of the hottest surroundings */
    frac16_t initial;   /* assumed after a reset, which loses the temperature */
    frac16_t derating;  /* from here on the current limit falls .. */
    frac16_t maximum;   /* .. until it is the rated current here; a fault can be cleared below it */
    frac16_t fault; /* FAULT_MOTOR_TEMPERATURE from this temperature on */
    frac16_t rated_current; /* that may flow for ever */
} winding_model_config_t;

typedef struct {
    frac32_t temperature; /* estimate, Q1.31 of 256 deg C */
    uint32_t squares; /* i_d^2 + i_q^2 of the ticks of this step, 30 fraction bits, over their number */
    uint16_t ticks;   /* of this step */
    bool hot;
} winding_model_t;

void winding_model_init(winding_model_t *model, const winding_model_config_t *config);

/* One slow tick; true when a step is due. */
static inline bool winding_model_add(winding_model_t *model, dq_t current)
{
    const uint32_t square = (uint32_t)((int32_t)current.d * current.d) + (uint32_t)((int32_t)current.q * current.q);
    model->squares += square / WINDING_TICKS;
    model->ticks++;
    return model->ticks == WINDING_TICKS;
}

/* The heat balance of the ticks that were added; sees to `hot`, which without `supervised` never is. */
void winding_model_step(winding_model_t *model, const winding_model_config_t *config, bool supervised);

/* Length of the current vector that the winding bears at its temperature: from `max` down; FRAC16_MAX while it is cool. */
frac16_t winding_model_limit(const winding_model_t *model, const winding_model_config_t *config, frac16_t max);

/* The temperature as it is published. */
static inline frac16_t winding_model_shown(const winding_model_t *model)
{
    return (frac16_t)asr32(model->temperature, 16);
}

static inline finding_set_t winding_model_findings(const winding_model_t *model)
{
    return model->hot ? FOUND(FINDING_WINDING_HOT) : 0U;
}

#endif

/* winding_model.h - thermal model of the motor winding (I2t): temperature from the currents, and permitted current.
 *
 *   C dT/dt = 3/2 R(T) (i_d^2 + i_q^2) - (T - T_ambient) / R_th,   R(T) = R_s (1 + 0.00393/K (T - 25 deg C))
 *
 * One heat capacity, one thermal resistance, assumed ambient temperature. The squared currents are summed in every slow
 * tick, the heat balance is computed once per WINDING_TICKS.
 */
#ifndef SERVO_DIAGNOSIS_WINDING_MODEL_H
#define SERVO_DIAGNOSIS_WINDING_MODEL_H

#include "control/transforms.h"
#include "diagnosis/evidence.h"
#include "math/frac.h"

#define WINDING_TICKS 64U /* slow ticks per step (32 ms), a power of two */

/* Temperatures: Q1.15 of 256 deg C. */
typedef struct {
    int32_t heating;    /* temperature rise per step at full-scale current and 25 deg C, 32 fraction bits */
    int32_t cooling;    /* part of the temperature rise over `ambient` that is lost per step, 32 fraction bits */
    frac16_t ambient;   /* highest ambient temperature */
    frac16_t initial;   /* temperature assumed after a reset */
    frac16_t derating;  /* temperature above which the current limit is reduced */
    frac16_t maximum; /* temperature of the full derating to the rated current; below it a fault can be cleared */
    frac16_t fault; /* temperature of FAULT_MOTOR_TEMPERATURE */
    frac16_t rated_current; /* permitted continuous current, Q1.15 of full-scale current */
} winding_model_config_t;

typedef struct {
    frac32_t temperature; /* estimated temperature, Q1.31 of 256 deg C */
    uint32_t squares; /* mean of i_d^2 + i_q^2 in this step, 30 fraction bits */
    uint16_t ticks; /* slow ticks of this step */
    bool hot; /* above `fault`, with hysteresis */
} winding_model_t;

void winding_model_init(winding_model_t *model, const winding_model_config_t *config);

/* One slow tick; true if a step is due. */
static inline bool winding_model_add(winding_model_t *model, dq_t current)
{
    const uint32_t square = (uint32_t)((int32_t)current.d * current.d) + (uint32_t)((int32_t)current.q * current.q);
    model->squares += square / WINDING_TICKS;
    model->ticks++;
    return model->ticks == WINDING_TICKS;
}

/* Heat balance of the added ticks; updates `hot`, which stays false if not `supervised`. */
void winding_model_step(winding_model_t *model, const winding_model_config_t *config, bool supervised);

/* Permitted length of the current vector at the present temperature, at most `max`. FRAC16_MAX: not reduced, at or
 * below `derating` or if `max` is not above the rated current. */
frac16_t winding_model_limit(const winding_model_t *model, const winding_model_config_t *config, frac16_t max);

/* Temperature as published, Q1.15 of 256 deg C. */
static inline frac16_t winding_model_shown(const winding_model_t *model)
{
    return (frac16_t)asr32(model->temperature, 16);
}

static inline finding_set_t winding_model_findings(const winding_model_t *model)
{
    return model->hot ? FOUND(FINDING_WINDING_HOT) : 0U;
}

#endif

/* dead_time.h - compensation of dead time and switch drops.
 *
 * With both switches open the current chooses the diode, and every conducting path drops some volts: the mean phase
 * voltage is short of the duty by (t_d f + V_drop / u_dc) u_dc against the direction of the current. Around zero current
 * the direction is uncertain within the ripple, so the sign is softened to a ramp.
 */
#ifndef SERVO_CONTROL_DEAD_TIME_H
#define SERVO_CONTROL_DEAD_TIME_H

#include "control/transforms.h"

typedef struct {
    frac16_t duty;   /* t_d f: part of a PWM period */
    frac16_t v_drop; /* over the full-scale bus */
    int16_t slope;   /* full-scale current over the current at which the sign is certain, 8 fraction bits */
} dead_time_config_t;

#define DEAD_TIME_SLOPE_BITS 8

/* A leg at 0 or 100 % does not switch and has no dead time; its drop cannot be made up either. */
static inline int32_t dead_time_leg(int32_t duty, int32_t current, int32_t loss, int32_t slope)
{
    if ((uint32_t)(duty - 1) >= FRAC16_MAX - 1U) {
        return duty;
    }
    const int32_t sign = sat16_asr(current * slope, DEAD_TIME_SLOPE_BITS);
    return sat15(duty + asr32(loss * sign + INT32_C(0x4000), 15));
}

/* Duties that give the wanted mean voltages; `reciprocal` is 2^29 / u_dc (Q1.15 of the full-scale bus). */
static inline abc_t dead_time_compensate(const dead_time_config_t *config, abc_t duty, abc_t current,
                                         int32_t reciprocal)
{
    const frac16_t drop = sat16_asr(config->v_drop * reciprocal + INT32_C(0x2000), 14);
    const frac16_t loss = f16_add(config->duty, drop);
    return (abc_t){
        dead_time_leg(duty.a, current.a, loss, config->slope),
        dead_time_leg(duty.b, current.b, loss, config->slope),
        dead_time_leg(duty.c, current.c, loss, config->slope),
    };
}

#endif

/* dead_time.h - compensation of dead time and switch drops.
 *
 * During the dead time the sign of the current determines which diode conducts. Mean voltage error per phase:
 *   -(t_d f + V_drop / u_dc) u_dc sign(i)
 * Near zero current the ripple makes the sign uncertain: there the sign function is replaced by a ramp.
 */
#ifndef SERVO_CONTROL_DEAD_TIME_H
#define SERVO_CONTROL_DEAD_TIME_H

#include "control/transforms.h"

typedef struct {
    frac16_t duty; /* t_d f: dead time as a part of the PWM period, Q1.15 (`duty` in axis_config.toml) */
    frac16_t v_drop; /* voltage drop of a switch or diode, Q1.15 of full-scale bus voltage */
    int16_t slope;   /* full-scale current / current above which the sign is certain, 8 fraction bits */
} dead_time_config_t;

#define DEAD_TIME_SLOPE_BITS 8

/* Legs at 0 or 100 % do not switch: no dead time, and their voltage drop cannot be compensated. */
static inline int32_t dead_time_leg(int32_t duty, int32_t current, int32_t loss, int32_t slope)
{
    if ((uint32_t)(duty - 1) >= FRAC16_MAX - 1U) {
        return duty;
    }
    const int32_t sign = sat16_asr(current * slope, DEAD_TIME_SLOPE_BITS);
    return sat15(duty + asr32(loss * sign + INT32_C(0x4000), 15));
}

/* Duties that produce the commanded mean voltages:
 *   d' = d + (t_d f + V_drop / u_dc) s(i),  s(i) = limit(i / i_s, -1, 1)
 * with the current i_s above which the sign is certain. `reciprocal` is 2^29 / u_dc (Q1.15 of the full-scale bus). */
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

#include "drive/angle_watch.h"

#include "drive/axis.h"

/* Without these nobody knows the voltage well enough. */
#define NEEDED (FEATURE_DEAD_TIME | FEATURE_BUS_COMPENSATION)

#define TICKS_MOST 4U
#define FILTER_SHIFT 2 /* four slow ticks: noise, times the controllers' gain, is as large as the back-EMF looked for */
#define EMF_OVER_SIZE 3 /* a slip turns the back-EMF, so it takes twice its size at most */

/* The voltage beyond resistance, decoupling and back-EMF. */
static void filter(axis_t *axis, int32_t emf)
{
    const current_loop_t *loop = &axis->current_loop;
    const current_loop_config_t *config = &axis->config->current_loop;
    const gain_t resistance = axis->config->phases.resistance;
    const int32_t omega = f16_from_f32(loop->omega_e);
    const int32_t turned_d = i32_gain(asr32(omega * loop->current.q, 15), config->omega_l_q);
    const int32_t turned_q = i32_gain(asr32(omega * loop->current.d, 15), config->omega_l_d);
    const int32_t d = loop->voltage.d - i32_gain(loop->current.d, resistance) + turned_d;
    const int32_t q = loop->voltage.q - i32_gain(loop->current.q, resistance) - turned_q - emf;
    dq_t *beyond = &axis->angle_watch.beyond;
    beyond->d = sat16(beyond->d + asr32(d - beyond->d, FILTER_SHIFT));
    beyond->q = sat16(beyond->q + asr32(q - beyond->q, FILTER_SHIFT));
}

/* What dead time, a quarter of the inductance, a change of the current, and half of the back-EMF that is expected account
 * for: 29 degrees of it, or its size. Along the current half of the resistance may be added; much more is no back-EMF. Of a
 * small current neither the direction is certain nor what a dead time does to it. */
static bool contradicts(const axis_t *axis, int32_t size, int32_t changed, int32_t emf)
{
    const phase_watch_config_t *config = &axis->config->phases;
    const dq_t i = axis->current_loop.current;
    const dq_t beyond = axis->angle_watch.beyond;
    const int32_t omega = i32_abs(f16_from_f32(axis->current_loop.omega_e));
    const int32_t turned = i32_gain(asr32(omega * size, 15), axis->config->current_loop.omega_l_q);
    const bool certain = size >= 2 * (int32_t)config->silent;
    const int32_t lost = certain ? config->emf_floor / 4 : 2 * (int32_t)config->emf_floor;
    const int32_t known = sat16(lost + turned / 4 + i32_gain(changed, config->inductance) + emf / 2);
    const int32_t drop = i32_gain(size, config->resistance) / 2;
    const int32_t length = length_about(beyond.d, beyond.q);
    const int32_t across = i32_abs(asr32((int32_t)beyond.d * i.q, 1) - asr32((int32_t)beyond.q * i.d, 1));
    return length < known + drop + EMF_OVER_SIZE * emf &&
           (length > known + drop || (certain && across > asr32(known * size, 1)));
}

fault_set_t angle_watch_step(axis_t *axis)
{
    angle_watch_t *watch = &axis->angle_watch;
    const dq_t i = axis->current_loop.current;
    const dq_t before = watch->current;
    const bool moves = axis->encoder_watch.calm == 0U; /* else it is the count that is in doubt */
    const int32_t size = (moves && (axis->features & NEEDED) == NEEDED) ? length_about(i.d, i.q) : 0;
    watch->current = i;
    if (size < (int32_t)axis->config->phases.silent) {
        watch->beyond = (dq_t){0, 0};
        watch->ticks = 0;
        return 0;
    }
    const int32_t changed = length_about(f16_sub(i.d, before.d), f16_sub(i.q, before.q));
    const int32_t emf = estimate_emf_at(axis, axis->current_loop.omega_e); /* where the encoder has it */
    filter(axis, emf);
    if (i32_abs(emf) > axis->config->phases.emf_floor / 4 && contradicts(axis, size, changed, i32_abs(emf))) {
        watch->ticks++;
    } else if (watch->ticks > 0U) {
        watch->ticks--;
    }
    if (watch->ticks == 0U) {
        phase_watch_forget_currents(&axis->phases);
    }
    const bool lasts = watch->ticks > TICKS_MOST && phase_watch_all_carry(&axis->phases);
    return lasts ? phase_watch_or(axis, FAULT_ANGLE_MISMATCH) : 0U;
}

fault_set_t angle_watch_rather(const axis_t *axis, fault_set_t fault)
{
    const dq_t beyond = axis->angle_watch.beyond;
    const int32_t emf = i32_abs(estimate_emf_at(axis, axis->current_loop.omega_e));
    const bool elsewhere = length_about(beyond.d, beyond.q) > emf + axis->config->phases.emf_floor / 4;
    return (elsewhere && !axis->sensorless) ? axis_fault_or(axis, FAULT_ANGLE_MISMATCH, fault) : fault;
}

/* shaft_monitor.h - stall, runaway, following error and over-speed of a shaft in SPIN. Inline for speed. */
#ifndef SERVO_DIAGNOSIS_SHAFT_MONITOR_H
#define SERVO_DIAGNOSIS_SHAFT_MONITOR_H

#include "config/contract_gen.h"
#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

typedef struct {
    frac32_t runaway_margin; /* tolerated excess or gain of speed, Q1.31 of full-scale speed */
    uint16_t runaway_ticks_max; /* permitted slow ticks with rising instead of falling speed */
    uint16_t stall_ticks_max; /* permitted slow ticks at full current without movement */
    uint16_t following_ticks_max; /* permitted slow ticks with a too large following error */
    uint16_t over_speed_ticks_max; /* permitted slow ticks of over-speed */
} shaft_monitor_config_t;

typedef struct {
    uint16_t stall_ticks; /* consecutive slow ticks at full current without movement */
    uint16_t runaway_ticks; /* consecutive slow ticks with rising instead of falling speed */
    uint32_t braked_speed; /* lowest speed since the deceleration began, 31 fraction bits of full-scale speed */
    uint16_t following_ticks; /* consecutive slow ticks with a too large following error */
    uint16_t over_speed_ticks; /* consecutive slow ticks of over-speed */
} shaft_monitor_t;

static inline uint16_t shaft_count_while(bool holds, uint16_t ticks) { return holds ? (uint16_t)(ticks + 1U) : 0U; }

/* Runaway: the speed rises although it must fall, because the full current decelerates the shaft or the speed
 * exceeds its limit. Cause: a wrong encoder angle, which reverses the torque, or a load stronger than the drive. */
static inline bool shaft_runaway(shaft_monitor_t *m, const shaft_monitor_config_t *config, const shaft_observation_t *o)
{
    /* uint32_t holds the sum of two positive Q1.31 numbers */
    const uint32_t speed = (uint32_t)f32_abs(o->speed);
    const uint32_t margin = (uint32_t)config->runaway_margin;
    const bool beyond = speed > (uint32_t)o->speed_limit + margin;
    if (!(o->decelerated_at_limit || beyond) || speed < m->braked_speed) {
        m->braked_speed = speed;
    }
    m->runaway_ticks = shaft_count_while(speed > m->braked_speed + margin, m->runaway_ticks);
    return m->runaway_ticks > config->runaway_ticks_max;
}

static inline bool shaft_following_error(shaft_monitor_t *m, const shaft_monitor_config_t *config,
                                         const shaft_observation_t *o)
{
    const int32_t max = o->following_error_max;
    const bool on = (o->features & FEATURE_FOLLOWING_ERROR) != 0U;
    m->following_ticks =
        shaft_count_while(on && (o->following_error > max || o->following_error < -max), m->following_ticks);
    return m->following_ticks > config->following_ticks_max;
}

static inline bool shaft_over_speed(shaft_monitor_t *m, const shaft_monitor_config_t *config,
                                    const shaft_observation_t *o)
{
    const bool on = (o->features & FEATURE_OVER_SPEED) != 0U;
    m->over_speed_ticks = shaft_count_while(on && f32_abs(o->speed) > o->over_speed_max, m->over_speed_ticks);
    return m->over_speed_ticks > config->over_speed_ticks_max;
}

/* One slow tick, after the controllers. Returns the confirmed findings. */
static inline finding_set_t shaft_monitor_step(shaft_monitor_t *m, const shaft_monitor_config_t *config,
                                               const shaft_observation_t *o)
{
    finding_set_t findings = shaft_runaway(m, config, o) ? FOUND(FINDING_RUNAWAY) : 0U;
    m->stall_ticks = shaft_count_while(o->no_movement_at_limit, m->stall_ticks);
    if (m->stall_ticks > config->stall_ticks_max) {
        findings |= FOUND(FINDING_SHAFT_BLOCKED);
    }
    if ((o->features & (FEATURE_FOLLOWING_ERROR | FEATURE_OVER_SPEED)) == 0U) {
        m->following_ticks = 0;
        m->over_speed_ticks = 0;
        return findings;
    }
    if (shaft_following_error(m, config, o)) {
        findings |= FOUND(FINDING_FOLLOWING_ERROR);
    }
    if (shaft_over_speed(m, config, o)) {
        findings |= FOUND(FINDING_OVER_SPEED);
    }
    return findings;
}

#endif

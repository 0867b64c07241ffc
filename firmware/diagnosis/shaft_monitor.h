/* shaft_monitor.h - what a spinning shaft must not do: stand at full current, run away, leave its set-point, turn too
 * fast. Inline: the slow loop calls it once, with what it has in registers. */
#ifndef SERVO_DIAGNOSIS_SHAFT_MONITOR_H
#define SERVO_DIAGNOSIS_SHAFT_MONITOR_H

#include "config/contract_gen.h"
#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

typedef struct {
    frac32_t runaway_margin; /* speed beyond the limit, or gained against the current, that is not tolerated */
    uint16_t runaway_ticks_max; /* slow ticks of gaining speed that should be lost */
    uint16_t stall_ticks_max; /* slow ticks at full current without movement */
    uint16_t following_ticks_max; /* slow ticks too far from the set-point */
    uint16_t over_speed_ticks_max; /* slow ticks of turning too fast */
} shaft_monitor_config_t;

typedef struct {
    uint16_t stall_ticks; /* slow ticks at full current without movement */
    uint16_t runaway_ticks; /* slow ticks of gaining speed that should be lost */
    uint32_t braked_speed; /* least speed since it should have been falling, 31 fraction bits */
    uint16_t following_ticks; /* slow ticks too far from the set-point */
    uint16_t over_speed_ticks; /* slow ticks of turning too fast */
} shaft_monitor_t;

static inline uint16_t shaft_count_while(bool holds, uint16_t ticks) { return holds ? (uint16_t)(ticks + 1U) : 0U; }

/* Braked by the full current, or beyond its limit, the shaft has to lose speed, or at least not to gain any: a wrong
 * encoder angle turns the torque round. */
static inline bool shaft_runs_away(shaft_monitor_t *m, const shaft_monitor_config_t *config,
                                   const shaft_observation_t *o)
{
    /* Sums of two fractions fit without a sign. */
    const uint32_t speed = (uint32_t)f32_abs(o->speed);
    const uint32_t margin = (uint32_t)config->runaway_margin;
    const bool beyond = speed > (uint32_t)o->speed_limit + margin;
    if (!(o->decelerated_at_limit || beyond) || speed < m->braked_speed) {
        m->braked_speed = speed;
    }
    m->runaway_ticks = shaft_count_while(speed > m->braked_speed + margin, m->runaway_ticks);
    return m->runaway_ticks > config->runaway_ticks_max;
}

static inline bool shaft_off_path(shaft_monitor_t *m, const shaft_monitor_config_t *config,
                                  const shaft_observation_t *o)
{
    const int32_t max = o->following_error_max;
    const bool on = (o->features & FEATURE_FOLLOWING_ERROR) != 0U;
    m->following_ticks =
        shaft_count_while(on && (o->following_error > max || o->following_error < -max), m->following_ticks);
    return m->following_ticks > config->following_ticks_max;
}

static inline bool shaft_too_fast(shaft_monitor_t *m, const shaft_monitor_config_t *config,
                                  const shaft_observation_t *o)
{
    const bool on = (o->features & FEATURE_OVER_SPEED) != 0U;
    m->over_speed_ticks = shaft_count_while(on && f32_abs(o->speed) > o->over_speed_max, m->over_speed_ticks);
    return m->over_speed_ticks > config->over_speed_ticks_max;
}

/* One slow tick, after the controllers: what is confirmed. */
static inline finding_set_t shaft_monitor_step(shaft_monitor_t *m, const shaft_monitor_config_t *config,
                                               const shaft_observation_t *o)
{
    finding_set_t findings = shaft_runs_away(m, config, o) ? FOUND(FINDING_RUNAWAY) : 0U;
    m->stall_ticks = shaft_count_while(o->no_movement_at_limit, m->stall_ticks);
    if (m->stall_ticks > config->stall_ticks_max) {
        findings |= FOUND(FINDING_SHAFT_BLOCKED);
    }
    if ((o->features & (FEATURE_FOLLOWING_ERROR | FEATURE_OVER_SPEED)) == 0U) {
        m->following_ticks = 0;
        m->over_speed_ticks = 0;
        return findings;
    }
    if (shaft_off_path(m, config, o)) {
        findings |= FOUND(FINDING_FOLLOWING_ERROR);
    }
    if (shaft_too_fast(m, config, o)) {
        findings |= FOUND(FINDING_OVER_SPEED);
    }
    return findings;
}

#endif

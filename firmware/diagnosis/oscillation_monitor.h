/* oscillation_monitor.h - sustained oscillation of the current: a loop that is not stable with its load. Inline for
 * speed.
 *
 * A turning point of the current is where it has come back from its last extreme, by `swing_min` and by a quarter of the
 * previous swing, so that noise on a large oscillation does not count. Turning points without a longer pause than half
 * of the longest period are an oscillation. Neither a step nor noise or friction gives so many in a row; a set-point
 * does only if it alternates faster than that (firmware/doc/oscillation.md).
 */
#ifndef SERVO_DIAGNOSIS_OSCILLATION_MONITOR_H
#define SERVO_DIAGNOSIS_OSCILLATION_MONITOR_H

#include "math/frac.h"

#define OSCILLATION_PAUSE_MAX 20U /* slow ticks between two turning points: 50 Hz */
#define OSCILLATION_TICKS_MAX 400U /* permitted duration, slow ticks: 0.2 s */
#define OSCILLATION_HALF_RATE 1000U /* frequency of one turning point per slow tick, Hz */

typedef struct {
    uint16_t swing_min; /* smallest swing that counts, peak to peak, Q1.15 of full-scale current */
    frac16_t extreme; /* largest or smallest value since the last turning point, Q1.15 of full-scale current */
    frac16_t opposite; /* extreme before that one */
    uint16_t swing; /* swing between these two when the last turning point was found, Q1.15 of full-scale current */
    bool falling; /* `extreme` is the smallest value */
    uint16_t pause; /* slow ticks since the last turning point, at most OSCILLATION_PAUSE_MAX + 1 */
    uint16_t turns; /* turning points of this oscillation after the first one */
    uint16_t ticks; /* slow ticks between the first and the last of them */
    uint16_t frequency; /* of the last oscillation that was found, Hz; 0: none */
} oscillation_monitor_t;

/* Forget an oscillation in progress, while the host commands a current or a test signal. */
static inline void oscillation_monitor_restart(oscillation_monitor_t *m)
{
    m->turns = 0;
    m->ticks = 0;
}

static inline void oscillation_turn(oscillation_monitor_t *m, frac16_t current)
{
    const int32_t swing = (int32_t)m->extreme - m->opposite;
    m->swing = (uint16_t)((swing < 0) ? -swing : swing);
    m->opposite = m->extreme;
    m->falling = !m->falling;
    m->extreme = current;
    if (m->pause <= OSCILLATION_PAUSE_MAX) {
        m->turns++;
        m->ticks = (uint16_t)(m->ticks + m->pause);
    }
    m->pause = 0;
}

/* One slow tick. True if the current has oscillated for the permitted duration; then it counts anew. */
static inline bool oscillation_monitor_step(oscillation_monitor_t *m, frac16_t current)
{
    const frac16_t back = m->falling ? f16_sub(current, m->extreme) : f16_sub(m->extreme, current);
    if (m->pause <= OSCILLATION_PAUSE_MAX) {
        m->pause++;
    }
    if (m->pause > OSCILLATION_PAUSE_MAX) {
        m->swing = 0;
        oscillation_monitor_restart(m);
    }
    if (back <= 0) {
        m->extreme = current;
    } else if ((uint16_t)back >= m->swing_min && (uint16_t)back >= m->swing / 4U) {
        oscillation_turn(m, current);
    }
    if (m->ticks < OSCILLATION_TICKS_MAX) {
        return false;
    }
    m->frequency = (uint16_t)((uint32_t)m->turns * OSCILLATION_HALF_RATE / m->ticks);
    oscillation_monitor_restart(m);
    return true;
}

#endif

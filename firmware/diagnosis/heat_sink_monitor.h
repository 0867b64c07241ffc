/* heat_sink_monitor.h - over-temperature of a heat sink, with hysteresis.
 *
 * The ADC code of the sensor is compared with two codes, which the tuning code computes from the sensor characteristic:
 * linear, or NTC in a voltage divider (code falls with temperature).
 */
#ifndef SERVO_DIAGNOSIS_HEAT_SINK_MONITOR_H
#define SERVO_DIAGNOSIS_HEAT_SINK_MONITOR_H

#include "diagnosis/evidence.h"
#include "diagnosis/observation.h"

#define HEAT_TICKS 16U /* 8 ms: longer than noise, shorter than any thermal time constant */

typedef struct {
    uint16_t hot;  /* ADC code at the limit */
    uint16_t cool; /* ADC code of the clear threshold (hysteresis); larger than `hot` for an NTC */
} heat_sink_monitor_config_t;

typedef struct {
    uint16_t ticks; /* slow ticks at or beyond the limit */
    bool hot; /* over-temperature */
} heat_sink_monitor_t;

/* One slow tick. */
static inline void heat_sink_monitor_step(heat_sink_monitor_t *monitor, const heat_sink_monitor_config_t *config,
                                          const observation_t *observation, evidence_t *evidence)
{
    const uint16_t code = observation->temperature;
    const bool rising = config->hot > config->cool;
    const bool beyond = rising ? code >= config->hot : code <= config->hot;
    const bool cool = rising ? code < config->cool : code > config->cool;
    monitor->ticks = beyond ? (uint16_t)(monitor->ticks + 1U) : 0U;
    if (monitor->ticks >= HEAT_TICKS) {
        monitor->hot = true;
        monitor->ticks = HEAT_TICKS;
    } else if (cool) {
        monitor->hot = false;
    }
    if (monitor->hot) {
        evidence->confirmed |= FOUND(FINDING_HEAT_SINK_HOT);
    }
}

#endif

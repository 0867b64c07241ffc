/* bus_monitor.h - DC-bus voltage and hardware over-current latch, checked in every PWM period. */
#ifndef SERVO_DIAGNOSIS_BUS_MONITOR_H
#define SERVO_DIAGNOSIS_BUS_MONITOR_H

#include "diagnosis/evidence.h"

typedef struct {
    frac16_t u_dc_max; /* over-voltage, Q1.15 of full-scale bus voltage; higher while a brake resistor is available */
    frac16_t u_dc_min; /* under-voltage threshold, Q1.15 of full-scale bus voltage */
} bus_monitor_t;

/* Fast test of the bus voltage for the fast loop. */
static inline bool bus_monitor_fault_possible(const bus_monitor_t *monitor, frac16_t u_dc)
{
    return u_dc > monitor->u_dc_max || u_dc < monitor->u_dc_min;
}

/* Present findings. `settled`: the filter of the bus voltage has settled after a reset. `over_current`: the hardware
 * latch has switched the outputs off. */
finding_set_t bus_monitor_findings(const bus_monitor_t *monitor, frac16_t u_dc, bool settled, bool over_current);

#endif

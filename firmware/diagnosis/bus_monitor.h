/* bus_monitor.h - the voltage of the DC bus, and the latch of the hardware's over-current break: what the fast loop looks
 * at in every period. */
#ifndef SERVO_DIAGNOSIS_BUS_MONITOR_H
#define SERVO_DIAGNOSIS_BUS_MONITOR_H

#include "diagnosis/evidence.h"

typedef struct {
    frac16_t u_dc_max; /* over-voltage, as long as the brake resistor is as it is */
    frac16_t u_dc_min; /* under-voltage */
} bus_monitor_t;

/* Quick answer for the fast loop. */
static inline bool bus_monitor_fault_possible(const bus_monitor_t *monitor, frac16_t u_dc)
{
    return u_dc > monitor->u_dc_max || u_dc < monitor->u_dc_min;
}

/* What is there now. `settled`: the filter of the bus voltage has come up after a reset. */
finding_set_t bus_monitor_findings(const bus_monitor_t *monitor, frac16_t u_dc, bool settled, bool broken);

#endif

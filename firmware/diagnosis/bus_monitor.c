#include "diagnosis/bus_monitor.h"

finding_set_t bus_monitor_findings(const bus_monitor_t *monitor, frac16_t u_dc, bool settled, bool over_current)
{
    finding_set_t findings = 0;
    if (u_dc > monitor->u_dc_max) {
        findings |= FOUND(FINDING_OVER_VOLTAGE);
    }
    if (u_dc < monitor->u_dc_min && settled) {
        findings |= FOUND(FINDING_UNDER_VOLTAGE);
    }
    if (over_current) {
        findings |= FOUND(FINDING_OVER_CURRENT_TRIP);
    }
    return findings;
}

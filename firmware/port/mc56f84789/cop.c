/* cop.c - the watchdog: on after reset, off while the board is set up, then on and locked. */
#include "port/mc56f84789/drivers.h"

void cop_stop(hal_t *hal) { REG_WRITE(hal, COP_CTRL, SET_COP_CTRL_OFF); }

void cop_start(hal_t *hal)
{
    REG_WRITE(hal, COP_TOUT, SET_COP_TOUT);
    REG_WRITE(hal, COP_CTRL, SET_COP_CTRL);
}

uint16_t hal_late_loops(hal_t *hal) { return hal->late; }

bool hal_reset_by_watchdog(hal_t *hal) { return hal->watchdog_reset; }

void hal_watchdog_service(hal_t *hal)
{
    REG_WRITE(hal, COP_CNTR, COP_SERVICE_1);
    REG_WRITE(hal, COP_CNTR, COP_SERVICE_2);
}

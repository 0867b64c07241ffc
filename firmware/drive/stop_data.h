/* stop_data.h - configuration and state of the stop categories (stop.h). */
#ifndef SERVO_DRIVE_STOP_DATA_H
#define SERVO_DRIVE_STOP_DATA_H

#include "config/contract_gen.h"
#include "diagnosis/evidence.h"
#include "math/frac.h"

typedef struct {
    uint16_t disable;         /* stop_category_t, default of param.on_disable; hold: for hold_ticks */
    uint16_t quick_stop;      /* stop_category_t, default of param.on_quick_stop; hold: as long as enabled */
    fault_set_t shorted, ramp, hold; /* faults with this stop category; all others: coast */
    /* Highest speed for a short, Q1.31 of full-scale speed: the steady current K_e w / sqrt(R_s^2 + w^2 L_s^2) is
     * permitted (ST slide "Winding short"). */
    frac32_t short_speed;
    frac16_t short_current; /* largest current in a short, Q1.15 of full-scale current */
    uint16_t ticks_max; /* time-out of a stop, after which the outputs are switched off, slow ticks */
    uint16_t hold_ticks; /* duration of position hold after a disable or a fault, slow ticks */
} stop_config_t;

typedef struct {
    stop_category_t category; /* category of the stop in progress */
    uint16_t ticks; /* slow ticks since the start of the stop */
    uint16_t rest_ticks; /* slow ticks of position hold */
} stop_t;

#endif

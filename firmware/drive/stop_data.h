/* stop_data.h - configuration and state of the ways in which an axis comes to rest (stop.h). */
#ifndef SERVO_DRIVE_STOP_DATA_H
#define SERVO_DRIVE_STOP_DATA_H

#include "config/contract_gen.h"
#include "diagnosis/evidence.h"
#include "math/frac.h"

typedef struct {
    uint16_t disable;         /* default of the writable stop_category_t; hold: for hold_ticks */
    uint16_t quick_stop;      /* default of the writable stop_category_t; hold: as long as the drive is wanted */
    fault_set_t shorted, ramp, hold; /* faults that are answered so; all others coast */
    /* Up to it the steady current of the short, K_e w / sqrt(R_s^2 + w^2 L_s^2), is allowed (ST slide "Winding
     * short"). */
    frac32_t short_speed;
    frac16_t short_current; /* and no more than this may flow */
    uint16_t ticks_max; /* slow ticks from the beginning of a stop until the outputs go off in any case */
    uint16_t hold_ticks; /* slow ticks that an axis without a drive holds its position */
} stop_config_t;

typedef struct {
    stop_category_t category; /* of the stop in progress, while the drive is not wanted */
    uint16_t ticks; /* slow ticks since it began */
    uint16_t rest_ticks; /* slow ticks at rest */
} stop_t;

#endif

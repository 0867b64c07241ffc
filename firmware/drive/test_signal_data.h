/* test_signal_data.h - a test signal on top of a set-point (excitation.h). */
#ifndef SERVO_DRIVE_TEST_SIGNAL_DATA_H
#define SERVO_DRIVE_TEST_SIGNAL_DATA_H

#include "config/contract_gen.h"
#include "control/swept_sine.h"

typedef struct {
    uint16_t point; /* test_point_t that the signal is added to; NONE: there is no signal */
    swept_sine_t sine;
    frac16_t value; /* of this call, of the full scale of the point */
    frac16_t limit; /* of the current that the signal is on */
} test_signal_t;

#endif

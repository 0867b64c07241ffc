/* test_signal_data.h - state of a test signal (test_signal.h). */
#ifndef SERVO_DRIVE_TEST_SIGNAL_DATA_H
#define SERVO_DRIVE_TEST_SIGNAL_DATA_H

#include "config/contract_gen.h"
#include "control/swept_sine.h"

typedef struct {
    uint16_t point; /* test_point_t; NONE: no signal */
    swept_sine_t sine;
    frac16_t value; /* present sample, Q1.15 of the full scale at the test point */
    frac16_t limit; /* limit of set-point plus signal at a current, Q1.15 of full-scale current */
} test_signal_t;

#endif

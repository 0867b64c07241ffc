#include "drive/run_step.h"

#include "drive/current_drive.h"
#include "drive/test_signal.h"

void spin_fast(axis_t *axis) { drive_current(axis, axis->feedback.theta_e); }

void spin_observed_fast(axis_t *axis) { drive_observed(axis, axis->feedback.theta_e); }

void spin_test_signal_fast(axis_t *axis) { test_signal_drive(axis, axis->feedback.theta_e); }

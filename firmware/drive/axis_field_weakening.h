/* axis_field_weakening.h - field weakening of one axis: when it may act, and what it looks at (doc/field-weakening.md). */
#ifndef SERVO_DRIVE_AXIS_FIELD_WEAKENING_H
#define SERVO_DRIVE_AXIS_FIELD_WEAKENING_H

#include "drive/axis_data.h"

/* Once per slow tick, between two slow loops: the next one takes i_d and the limits of i_q from `axis->weakening`. */
void axis_field_weakening_step(axis_t *axis);

#endif

/* axis_field_weakening.h - field weakening of one axis: enable and inputs of field_weakening.h
 * (doc/field-weakening.md). */
#ifndef SERVO_DRIVE_AXIS_FIELD_WEAKENING_H
#define SERVO_DRIVE_AXIS_FIELD_WEAKENING_H

#include "drive/axis_data.h"

/* Once per slow tick, between two slow loops; the next slow loop uses `axis->weakening`. */
void axis_field_weakening_step(axis_t *axis);

#endif

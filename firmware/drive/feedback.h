/* feedback.h - feedback sources for angle and speed: encoder, or observer of a sensorless axis. */
#ifndef SERVO_DRIVE_FEEDBACK_H
#define SERVO_DRIVE_FEEDBACK_H

#include "drive/feedback_data.h"

extern const feedback_source_t encoder_feedback;
extern const feedback_source_t observer_feedback;

#endif

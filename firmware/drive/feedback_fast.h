/* feedback_fast.h - what of the sources of angle and speed runs in every period. */
#ifndef SERVO_DRIVE_FEEDBACK_FAST_H
#define SERVO_DRIVE_FEEDBACK_FAST_H

struct axis;

void encoder_source_fast(struct axis *axis);
void observer_source_fast(struct axis *axis);

#endif

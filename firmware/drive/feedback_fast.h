/* feedback_fast.h - functions of the feedback sources in the fast loop. */
#ifndef SERVO_DRIVE_FEEDBACK_FAST_H
#define SERVO_DRIVE_FEEDBACK_FAST_H

struct axis;

void encoder_source_fast(struct axis *axis);
void observer_source_fast(struct axis *axis);

#endif

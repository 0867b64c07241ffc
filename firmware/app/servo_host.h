/* servo_host.h - the part of servo_init that is for the host: server, its callbacks, passwords. */
#ifndef SERVO_APP_SERVO_HOST_H
#define SERVO_APP_SERVO_HOST_H

#include "app/servo.h"

void servo_host_init(servo_t *servo);

#endif

/* servo_storage.h - what the application keeps in the data flash, and takes from there. */
#ifndef SERVO_APP_SERVO_STORAGE_H
#define SERVO_APP_SERVO_STORAGE_H

#include "app/servo.h"

/* A write of a part of the request, by its offset in servo_t. */
bool servo_storage_accept(servo_t *servo, uint16_t offset, bool whole, const uint8_t *data, uint16_t size);

/* The turn of the background. */
void servo_storage_step(servo_t *servo);

#endif

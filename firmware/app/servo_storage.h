/* servo_storage.h - connects app/storage.h to the data of servo_t. */
#ifndef SERVO_APP_SERVO_STORAGE_H
#define SERVO_APP_SERVO_STORAGE_H

#include "app/servo.h"

/* Check a write to the storage request, at `offset` of servo_t. */
bool servo_storage_accept(servo_t *servo, uint16_t offset, bool whole, const uint8_t *data, uint16_t size);

/* Called in the background loop. */
void servo_storage_step(servo_t *servo);

#endif

#include "port/arm/image.h"

#include <stddef.h>

#include "app/servo.h"

const uint32_t image_layout[] = {
    offsetof(servo_t, snapshot),
    sizeof(snapshot_t),
    offsetof(servo_t, axis[0].diagnosis.winding.temperature),
    offsetof(servo_t, axis[1].diagnosis.winding.temperature),
    offsetof(servo_t, freemaster.space),
};

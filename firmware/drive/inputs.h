/* inputs.h - the input pins of an axis, as a set of bits. */
#ifndef SERVO_DRIVE_INPUTS_H
#define SERVO_DRIVE_INPUTS_H

#define INPUT_HOME UINT16_C(1)
#define INPUT_LIMIT_MIN UINT16_C(2)
#define INPUT_LIMIT_MAX UINT16_C(4)
#define INPUT_ENABLE UINT16_C(8)

#endif

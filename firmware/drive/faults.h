/* faults.h - sets of faults: a bit per fault (FAULT_ of the contract), and the code of a single one. */
#ifndef SERVO_DRIVE_FAULTS_H
#define SERVO_DRIVE_FAULTS_H

#include <stdint.h>

typedef uint32_t fault_set_t;

/* Code of the lowest fault of a set: its bit plus one; 0 for no fault. */
uint16_t fault_code(fault_set_t faults);

#endif

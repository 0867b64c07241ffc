/* server_state.c - not linked: the size of this array is that of the server's memory. */
#include "app/servo.h"

uint8_t state_of_server[sizeof(freemaster_t) + sizeof(((servo_t *)0)->samples)];

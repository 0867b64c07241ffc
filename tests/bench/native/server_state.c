/* server_state.c - not linked: the size of this array is that of the server's memory. */
#include "comm/freemaster.h"

uint8_t state_of_server[sizeof(freemaster_t)];

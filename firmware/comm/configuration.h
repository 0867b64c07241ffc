/* configuration.h - GETCONFIG: what this server is and can, by key or by 1-based index. */
#ifndef COMM_CONFIGURATION_H
#define COMM_CONFIGURATION_H

#include <stdint.h>

#include "comm/freemaster_app.h"
#include "comm/payload.h"

uint8_t configuration_get(const freemaster_app_t *app, payload_reader_t *request, payload_writer_t *reply);

#endif

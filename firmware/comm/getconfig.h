/* getconfig.h - GETCONFIG: properties of the server, by key or by 1-based index. */
#ifndef COMM_GETCONFIG_H
#define COMM_GETCONFIG_H

#include <stdint.h>

#include "comm/freemaster_app.h"
#include "comm/payload.h"
#include "comm/status.h"

fm_status_t getconfig_answer(const freemaster_app_t *app, payload_reader_t *request, payload_writer_t *reply);

#endif

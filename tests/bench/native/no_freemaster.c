/* no_freemaster.c - in place of comm/: an application without a server, to measure its size. */
#include "comm/freemaster.h"

void freemaster_init(freemaster_t *server, const freemaster_app_t *app)
{
    (void)server;
    (void)app;
}

void freemaster_poll(freemaster_t *server, hal_t *hal)
{
    (void)server;
    (void)hal;
}

void freemaster_listen(freemaster_t *server, hal_t *hal)
{
    (void)server;
    (void)hal;
}

uint8_t freemaster_read(freemaster_t *server, uint32_t address, uint8_t *data, uint16_t size)
{
    (void)server;
    (void)address;
    (void)data;
    (void)size;
    return 0;
}

uint8_t freemaster_write(freemaster_t *server, uint32_t address, const uint8_t *data, const uint8_t *mask,
                         uint16_t size)
{
    (void)server;
    (void)address;
    (void)data;
    (void)mask;
    (void)size;
    return 0;
}

void recorder_take(recorder_t *recorder) { (void)recorder; }

uint16_t freemaster_console_room(const freemaster_t *server)
{
    (void)server;
    return 0;
}

void freemaster_print(freemaster_t *server, const uint8_t *text, uint16_t size)
{
    (void)server;
    (void)text;
    (void)size;
}

uint8_t freemaster_level(const freemaster_t *server)
{
    (void)server;
    return 0;
}

#include "comm/getconfig.h"

#include <string.h>

#include "comm/frame.h"
#include "comm/status.h"

#define KEY_SIZE 3u

#define SCOPES 1
#define PIPES 1
#define PROTOCOL_VERSION 4
#define FLAGS 0x02u /* little endian, remote access allowed */
#define FLAGS_GUARDED_AT 4u

/* The order is defined by the protocol. */
typedef enum {
    KEY_MTU = 1,
    KEY_VS,
    KEY_NM,
    KEY_DS,
    KEY_BD,
    KEY_F1,
    KEY_BA,
    KEY_RC,
    KEY_SC,
    KEY_PV,
    KEY_PC,
} configuration_key_t;

static const char *const keys[] = {"MTU", "VS", "NM", "DS", "BD", "F1", "BA", "RC", "SC", "PV", "PC"};
#define KEYS ((int32_t)(sizeof keys / sizeof keys[0]))

/* Index of the 00-terminated key that follows (only its first three characters are compared); 0 for an unknown key. */
static int32_t find_key(payload_reader_t *request)
{
    char key[KEY_SIZE + 1u] = {0};
    uint16_t size = 0;
    for (char c = (char)payload_get_u8(request); c != '\0'; c = (char)payload_get_u8(request)) {
        if (size < KEY_SIZE) {
            key[size++] = c;
        }
    }
    for (int32_t i = 0; i < KEYS; i++) {
        if (strcmp(keys[i], key) == 0) {
            return i + 1;
        }
    }
    return 0;
}

fm_status_t getconfig_answer(const freemaster_app_t *app, payload_reader_t *request, payload_writer_t *reply)
{
    int32_t index = payload_get_signed(request);
    if (index == 0 && !request->missing) {
        index = find_key(request);
    }
    if (request->missing) {
        return FM_BAD_SIZE; /* the vendor's server reads from the previous message */
    }
    if (index < 1 || index > KEYS) {
        return FM_DENIED; /* the vendor's server reads outside of its list for an index above 11 */
    }
    payload_put_string(reply, keys[index - 1]);
    switch ((configuration_key_t)index) {
    case KEY_MTU:
        payload_put_unsigned(reply, FRAME_MTU);
        break;
    case KEY_VS:
        payload_put_string(reply, app->version);
        break;
    case KEY_NM:
        payload_put_string(reply, app->name);
        break;
    case KEY_DS:
        payload_put_string(reply, app->description);
        break;
    case KEY_BD:
        payload_put_string(reply, app->build);
        break;
    case KEY_F1:
        payload_put_u8(reply, (uint8_t)(FLAGS | (unsigned)access_guarded(&app->passwords) << FLAGS_GUARDED_AT));
        break;
    case KEY_BA:
        payload_put_unsigned(reply, TSA_VARIABLES_BASE);
        break;
    case KEY_RC:
        payload_put_u8(reply, FREEMASTER_RECORDERS);
        break;
    case KEY_SC:
        payload_put_u8(reply, SCOPES);
        break;
    case KEY_PV:
        payload_put_u8(reply, PROTOCOL_VERSION);
        break;
    case KEY_PC:
        payload_put_u8(reply, PIPES);
        break;
    }
    return FM_OK_VARIABLE;
}

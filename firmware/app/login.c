#include "app/login.h"

#include <stddef.h>

#define SPREAD 31U

void login_passwords(access_passwords_t *passwords, const servo_config_t *config)
{
    for (uint16_t level = 0; level < ACCESS_LEVELS; level++) {
        const uint8_t *digest = config->password[level];
        unsigned bits = 0;
        for (uint16_t i = 0; i < SHA1_SIZE; i++) {
            bits |= digest[i];
        }
        passwords->password[level] = (bits != 0U) ? digest : NULL;
    }
}

uint32_t login_nonce(uint32_t tick, const axis_t *axes)
{
    uint32_t number = tick;
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        number = number * SPREAD + (uint16_t)axes[i].current_loop.current.q;
        number = number * SPREAD + (uint16_t)axes[i].u_dc;
    }
    return number;
}

/* login.h - password hashes of the configuration, and nonce of a challenge; comm/access.h checks the passwords. */
#ifndef SERVO_APP_LOGIN_H
#define SERVO_APP_LOGIN_H

#include <stdint.h>

#include "comm/access.h"
#include "config/axis_config.h"
#include "drive/axis.h"

/* Password hashes of the configuration, which are not copied. */
void login_passwords(access_passwords_t *passwords, const servo_config_t *config);

/* Nonce from the time of the request and the noise of ADC samples. */
uint32_t login_nonce(uint32_t tick, const axis_t *axes);

#endif

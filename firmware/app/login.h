/* login.h - password hashes of the configuration, and nonce of a challenge; comm/access.h checks the passwords. */
#ifndef SERVO_APP_LOGIN_H
#define SERVO_APP_LOGIN_H

#include <stdint.h>

#include "comm/access.h"
#include "drive/axis.h"

/* Password hashes of the configuration. */
void login_passwords(access_passwords_t *passwords);

/* Nonce from the time of the request and the noise of ADC samples. */
uint32_t login_nonce(uint32_t tick, const axis_t *axes);

#endif

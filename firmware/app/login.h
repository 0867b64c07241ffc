/* login.h - passwords of the configuration, and what makes their salts hard to foresee. */
#ifndef SERVO_APP_LOGIN_H
#define SERVO_APP_LOGIN_H

#include <stdint.h>

#include "comm/access.h"
#include "drive/axis.h"

void login_passwords(access_passwords_t *passwords);

/* From the time of a request and the noise of what is measured. */
uint32_t login_nonce(uint32_t tick, const axis_t *axes);

#endif

/* access.h - access levels of a client before and after a login (AUTH1, AUTH2).
 *
 * A level includes all lower levels. A level without a password has the password of the next lower level with one.
 * Levels below the lowest password are open after reset; without any password all levels are open, and AUTH1 and AUTH2
 * are unknown commands. The password is not transmitted: the client answers a challenge with SHA1(salt | SHA1(password)
 * | salt). A salt is valid until the next challenge or until the logout.
 */
#ifndef COMM_ACCESS_H
#define COMM_ACCESS_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/payload.h"
#include "comm/status.h"

#define ACCESS_NONE UINT8_C(0)
#define ACCESS_VIEW UINT8_C(1)    /* read memory */
#define ACCESS_COMMAND UINT8_C(2) /* read and write memory */
#define ACCESS_TUNE UINT8_C(3)    /* additionally write the variables of live tuning */
#define ACCESS_LEVELS 3

#define ACCESS_SALT_SIZE 16u

typedef struct {
    const uint8_t *password[ACCESS_LEVELS]; /* SHA-1 of the password per level, first ACCESS_VIEW; NULL: none */
} access_passwords_t;

typedef struct {
    access_passwords_t passwords;
    uint8_t level; /* granted level */
    bool salted; /* a challenge is open */
    uint8_t salt[ACCESS_SALT_SIZE]; /* salt of the open challenge */
} access_t;

void access_init(access_t *access, const access_passwords_t *passwords);

/* Lowest level with a password; ACCESS_NONE: no password. */
uint8_t access_guarded(const access_passwords_t *passwords);

/* AUTH1: u8 level. `nonce` must be different for each call. */
fm_status_t access_challenge(access_t *access, uint32_t nonce, payload_reader_t *request, payload_writer_t *reply);

/* AUTH2: u8 level, key. */
fm_status_t access_prove(access_t *access, payload_reader_t *request, payload_writer_t *reply);

#endif

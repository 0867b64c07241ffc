/* access.h - passwords: what a client may do before and after it has logged in (AUTH1, AUTH2).
 *
 * A level includes those below it. One without a password of its own has that of the next lower level that has one; the
 * levels below the lowest password are open from the start. Without any password all of them are, and the commands are
 * unknown. The password never goes over the line: the client proves with SHA1(salt | SHA1(password) | salt) that it has
 * it. A salt is good for one challenge: until the next one, or until the client logs out.
 */
#ifndef COMM_ACCESS_H
#define COMM_ACCESS_H

#include <stdbool.h>
#include <stdint.h>

#include "comm/payload.h"

#define ACCESS_NONE UINT8_C(0)
#define ACCESS_VIEW UINT8_C(1)    /* read memory */
#define ACCESS_COMMAND UINT8_C(2) /* and write it */
#define ACCESS_TUNE UINT8_C(3)    /* and write what the application keeps for tuning */
#define ACCESS_LEVELS 3

#define ACCESS_SALT_SIZE 16u

typedef struct {
    const uint8_t *password[ACCESS_LEVELS]; /* SHA-1 of it, from ACCESS_VIEW on; NULL: none of its own */
} access_passwords_t;

typedef struct {
    access_passwords_t passwords;
    uint8_t level; /* granted now */
    bool salted;   /* a challenge is open */
    uint8_t salt[ACCESS_SALT_SIZE]; /* of the open challenge */
} access_t;

void access_init(access_t *access, const access_passwords_t *passwords);

/* The lowest level with a password; ACCESS_NONE without any. */
uint8_t access_guarded(const access_passwords_t *passwords);

/* AUTH1: u8 level. `nonce` has to be another number every time. */
uint8_t access_challenge(access_t *access, uint32_t nonce, payload_reader_t *request, payload_writer_t *reply);

/* AUTH2: u8 level, key. */
uint8_t access_prove(access_t *access, payload_reader_t *request, payload_writer_t *reply);

#endif

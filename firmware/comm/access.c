#include "comm/access.h"

#include <stddef.h>
#include <string.h>

#include "comm/sha1.h"
#include "comm/status.h"

#define ALGORITHM_NONE 0u
#define ALGORITHM_SHA1 1u
#define NONCE_SIZE 4u

uint8_t access_guarded(const access_passwords_t *passwords)
{
    for (uint8_t level = ACCESS_VIEW; level <= ACCESS_TUNE; level++) {
        if (passwords->password[level - 1u] != NULL) {
            return level;
        }
    }
    return ACCESS_NONE;
}

/* Highest level that needs no password. */
static uint8_t open_level(const access_t *access)
{
    const uint8_t guarded = access_guarded(&access->passwords);
    return guarded == ACCESS_NONE ? ACCESS_TUNE : (uint8_t)(guarded - 1u);
}

/* Password that protects a level, NULL if it needs none; levels above ACCESS_TUNE count as ACCESS_TUNE. */
static const uint8_t *password_of(const access_t *access, uint8_t level)
{
    for (uint8_t k = level < ACCESS_TUNE ? level : ACCESS_TUNE; k > ACCESS_NONE; k--) {
        if (access->passwords.password[k - 1u] != NULL) {
            return access->passwords.password[k - 1u];
        }
    }
    return NULL;
}

void access_init(access_t *access, const access_passwords_t *passwords)
{
    access->passwords = *passwords;
    access->level = open_level(access);
    access->salted = false;
    memset(access->salt, 0, sizeof access->salt);
}

/* The new salt depends on the old one: a repeated nonce does not repeat a salt. */
static void renew_salt(access_t *access, uint32_t nonce)
{
    uint8_t seed[ACCESS_SALT_SIZE + NONCE_SIZE];
    uint8_t digest[SHA1_SIZE];
    memcpy(seed, access->salt, ACCESS_SALT_SIZE);
    for (uint16_t i = 0; i < NONCE_SIZE; i++) {
        seed[ACCESS_SALT_SIZE + i] = (uint8_t)(nonce >> (8u * i) & 0xFFu);
    }
    sha1(seed, sizeof seed, digest);
    memcpy(access->salt, digest, ACCESS_SALT_SIZE);
}

fm_status_t access_challenge(access_t *access, uint32_t nonce, payload_reader_t *request, payload_writer_t *reply)
{
    const uint8_t level = payload_get_u8(request);
    if (access_guarded(&access->passwords) == ACCESS_NONE) {
        return FM_UNKNOWN_COMMAND;
    }
    if (request->missing) {
        return FM_BAD_SIZE;
    }
    access->salted = password_of(access, level) != NULL;
    if (access->salted) {
        renew_salt(access, nonce);
        payload_put_unsigned(reply, ALGORITHM_SHA1);
        payload_put_bytes(reply, access->salt, ACCESS_SALT_SIZE);
    } else {
        access->level = level;
        payload_put_unsigned(reply, ALGORITHM_NONE);
    }
    return FM_OK_VARIABLE;
}

/* Constant-time comparison: the duration does not depend on the key. */
static bool matches(const access_t *access, const uint8_t *password, const uint8_t *key)
{
    uint8_t message[ACCESS_SALT_SIZE + SHA1_SIZE + ACCESS_SALT_SIZE];
    uint8_t expected[SHA1_SIZE];
    memcpy(message, access->salt, ACCESS_SALT_SIZE);
    memcpy(message + ACCESS_SALT_SIZE, password, SHA1_SIZE);
    memcpy(message + ACCESS_SALT_SIZE + SHA1_SIZE, access->salt, ACCESS_SALT_SIZE);
    sha1(message, sizeof message, expected);
    unsigned difference = 0;
    for (uint16_t i = 0; i < SHA1_SIZE; i++) {
        difference |= (unsigned)(key[i] ^ expected[i]);
    }
    return difference == 0;
}

/* The highest level whose password matches this key. */
static uint8_t proved(const access_t *access, const uint8_t *key)
{
    const uint8_t *checked = NULL;
    for (uint8_t level = ACCESS_TUNE; level > ACCESS_NONE; level--) {
        const uint8_t *password = password_of(access, level);
        if (password != NULL && password != checked && matches(access, password, key)) {
            return level;
        }
        checked = password;
    }
    return ACCESS_NONE;
}

fm_status_t access_prove(access_t *access, payload_reader_t *request, payload_writer_t *reply)
{
    const uint8_t level = payload_get_u8(request);
    const uint8_t *key = payload_take(request, SHA1_SIZE);
    if (access_guarded(&access->passwords) == ACCESS_NONE) {
        return FM_UNKNOWN_COMMAND;
    }
    if (key == NULL) {
        return FM_BAD_SIZE;
    }
    uint8_t granted = ACCESS_NONE;
    if (level != ACCESS_NONE) { /* for level 0 the vendor's server grants access with any key */
        granted = access->salted ? proved(access, key) : ACCESS_NONE;
        if (granted == ACCESS_NONE) {
            access->level = open_level(access);
            return FM_PASSWORD_WRONG;
        }
        granted = granted < level ? granted : level;
        access->level = granted;
    }
    payload_put_u8(reply, granted);
    return FM_OK;
}

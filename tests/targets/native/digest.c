#include "digest.h"

#include <stddef.h>
#include <string.h>

#include "app/variables.h"

/* CRC-32 with the reflected polynomial EDB88320, a byte at a time. The value of a byte is the sum of those of its bits. */
#define OF_BIT(byte, bit, value) (((byte) >> (bit) & 1) != 0 ? UINT32_C(value) : 0U)
#define OF_TWO(byte, bit, low, high) (OF_BIT(byte, bit, low) ^ OF_BIT(byte, (bit) + 1, high))
#define LOW_BITS(byte) (OF_TWO(byte, 0, 0x77073096, 0xEE0E612C) ^ OF_TWO(byte, 2, 0x076DC419, 0x0EDB8832))
#define HIGH_BITS(byte) (OF_TWO(byte, 4, 0x1DB71064, 0x3B6E20C8) ^ OF_TWO(byte, 6, 0x76DC4190, 0xEDB88320))
#define BYTES_1(byte) (LOW_BITS(byte) ^ HIGH_BITS(byte))
#define BYTES_4(byte) BYTES_1(byte), BYTES_1((byte) + 1), BYTES_1((byte) + 2), BYTES_1((byte) + 3)
#define BYTES_16(byte) BYTES_4(byte), BYTES_4((byte) + 4), BYTES_4((byte) + 8), BYTES_4((byte) + 12)
#define BYTES_64(byte) BYTES_16(byte), BYTES_16((byte) + 16), BYTES_16((byte) + 32), BYTES_16((byte) + 48)

static const uint32_t crc_of_byte[256] = {BYTES_64(0), BYTES_64(64), BYTES_64(128), BYTES_64(192)};

uint32_t digest_word(uint32_t value, uint16_t word)
{
    value ^= word;
    value = (value >> 8) ^ crc_of_byte[value & 0xFFU];
    return (value >> 8) ^ crc_of_byte[value & 0xFFU];
}

uint32_t digest_long(uint32_t value, uint32_t word)
{
    return digest_word(digest_word(value, (uint16_t)(word & 0xFFFFU)), (uint16_t)(word >> 16));
}

static bool in_snapshot(const tsa_entry_t *entry)
{
    const uint32_t begin = TSA_VARIABLES_BASE + (uint32_t)offsetof(servo_t, snapshot);
    return entry->kind == TSA_KIND_RO && entry->address >= begin && entry->address < begin + sizeof(snapshot_t);
}

/* Offset of a scalar of the snapshot; false for other variables and for the complete block. */
static bool find_field(uint16_t i, digest_field_t *field)
{
    const tsa_entry_t entry = tsa_entry(&servo_variables, i);
    field->at = (uint16_t)(entry.address - TSA_VARIABLES_BASE);
    field->wide = entry.size == sizeof(uint32_t);
    return in_snapshot(&entry) && (field->wide || entry.size == sizeof(uint16_t));
}

static uint32_t value_of(const servo_t *servo, const digest_field_t *field)
{
    const uint8_t *at = (const uint8_t *)servo + field->at;
    uint16_t narrow;
    uint32_t wide;
    if (field->wide) {
        memcpy(&wide, at, sizeof wide);
        return wide;
    }
    memcpy(&narrow, at, sizeof narrow);
    return narrow;
}

bool digest_snapshot_field(const servo_t *servo, uint16_t i, uint32_t *value)
{
    digest_field_t field;
    if (!find_field(i, &field)) {
        return false;
    }
    *value = value_of(servo, &field);
    return true;
}

static uint32_t fold_snapshot(const digest_t *digest, uint32_t crc, const servo_t *servo)
{
    for (uint16_t i = 0; i < digest->fields; i++) {
        crc = digest_long(crc, value_of(servo, &digest->field[i]));
    }
    return crc;
}

bool digest_init(digest_t *digest)
{
    digest->value = DIGEST_START;
    digest->tick = 0;
    digest->periods = 0;
    digest->fields = 0;
    for (uint16_t i = 0; i < servo_variables.entries; i++) {
        digest_field_t field;
        if (!find_field(i, &field)) {
            continue;
        }
        if (digest->fields == DIGEST_FIELDS_MAX) {
            return false;
        }
        digest->field[digest->fields++] = field;
    }
    return true;
}

void digest_call(digest_t *digest, call_t call, uint16_t axis, uint16_t left, uint16_t missing, const out_log_t *out,
                 const servo_t *servo)
{
    uint32_t crc = digest_word(digest->value, (uint16_t)((uint16_t)call | (uint16_t)(axis << 8)));
    crc = digest_word(crc, left);
    crc = digest_word(crc, missing);
    crc = digest_word(crc, out->size);
    for (uint16_t i = 0; i < out->size && i < EXCHANGE_OUT_MAX; i++) {
        crc = digest_word(crc, out->word[i]);
    }
    if (servo->snapshot.tick != digest->tick) {
        crc = fold_snapshot(digest, crc, servo);
        digest->tick = servo->snapshot.tick;
    }
    if (call == CALL_M2) {
        digest->periods++;
    }
    digest->value = crc;
}

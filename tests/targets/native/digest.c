#include "digest.h"

#include <stddef.h>
#include <string.h>

#include "app/variables.h"

/* CRC-32, four bits at a time: reflected polynomial EDB88320. */
static const uint32_t crc_of_nibble[16] = {
    UINT32_C(0x00000000), UINT32_C(0x1DB71064), UINT32_C(0x3B6E20C8), UINT32_C(0x26D930AC),
    UINT32_C(0x76DC4190), UINT32_C(0x6B6B51F4), UINT32_C(0x4DB26158), UINT32_C(0x5005713C),
    UINT32_C(0xEDB88320), UINT32_C(0xF00F9344), UINT32_C(0xD6D6A3E8), UINT32_C(0xCB61B38C),
    UINT32_C(0x9B64C2B0), UINT32_C(0x86D3D2D4), UINT32_C(0xA00AE278), UINT32_C(0xBDBDF21C),
};

uint32_t digest_word(uint32_t value, uint16_t word)
{
    value ^= word;
    for (uint16_t nibble = 0; nibble < 4U; nibble++) {
        value = (value >> 4) ^ crc_of_nibble[value & 15U];
    }
    return value;
}

uint32_t digest_long(uint32_t value, uint32_t word)
{
    return digest_word(digest_word(value, (uint16_t)(word & 0xFFFFU)), (uint16_t)(word >> 16));
}

bool digest_snapshot_field(const servo_t *servo, uint16_t i, uint32_t *value)
{
    const tsa_entry_t entry = tsa_entry(&servo_variables, i);
    const uint32_t begin = TSA_VARIABLES_BASE + (uint32_t)offsetof(servo_t, snapshot);
    if (entry.kind != TSA_KIND_RO || entry.address < begin || entry.address >= begin + sizeof servo->snapshot) {
        return false;
    }
    const uint8_t *at = (const uint8_t *)servo + (size_t)(entry.address - TSA_VARIABLES_BASE);
    uint16_t narrow;
    uint32_t wide;
    if (entry.size == sizeof narrow) {
        memcpy(&narrow, at, sizeof narrow);
        *value = narrow;
        return true;
    }
    if (entry.size == sizeof wide) {
        memcpy(&wide, at, sizeof wide);
        *value = wide;
        return true;
    }
    return false; /* the block as a whole */
}

static uint32_t fold_snapshot(uint32_t crc, const servo_t *servo)
{
    for (uint16_t i = 0; i < servo_variables.entries; i++) {
        uint32_t value;
        if (digest_snapshot_field(servo, i, &value)) {
            crc = digest_long(crc, value);
        }
    }
    return crc;
}

void digest_init(digest_t *digest)
{
    digest->value = DIGEST_START;
    digest->tick = 0;
    digest->periods = 0;
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
        crc = fold_snapshot(crc, servo);
        digest->tick = servo->snapshot.tick;
    }
    if (call == CALL_M2) {
        digest->periods++;
    }
    digest->value = crc;
}

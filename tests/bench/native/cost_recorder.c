/* cost_recorder.c - instructions that a call of recorder_sample() adds to an interrupt. Prints
 * "CASE MIN MAX SUM NUMBER" in hexadecimal. */
#include <stddef.h>

#include "comm/recorder.h"
#include "comm/status.h"
#include "machine.h"
#include "text.h"

#define VARIABLES 8U
#define POINTS 32U
#define CALLS 256U

#define TRIGGER_SIGNED_EDGE 0x12U
#define START 0x03U

typedef struct {
    uint8_t variables;
    uint8_t size;
    uint8_t trigger; /* of the first slot */
    uint8_t divider;
    uint8_t started;
} case_t;

/* In the order of firmware_cost/recorder.py. */
static const case_t cases[] = {
    {4, 2, 0, 0, 0}, /* idle */
    {4, 2, 0, 0, 1},
    {4, 4, 0, 0, 1},
    {8, 2, 0, 0, 1},
    {4, 2, TRIGGER_SIGNED_EDGE, 0, 1},
    {4, 4, TRIGGER_SIGNED_EDGE, 0, 1},
};
#define CASES (sizeof cases / sizeof cases[0])

static int32_t variables[VARIABLES];
static uint32_t samples[POINTS * VARIABLES];
static recorder_memory_t memory = {.samples = samples, .size = sizeof samples};
static recorder_t recorder;

static const uint8_t strings[] = "v\0\xE2";
static const tsa_entry_t entry = {0, 2, TSA_VARIABLES_BASE, (uint16_t)sizeof variables, TSA_KIND_RW};
static const tsa_table_t table = {&entry, 1, strings, (uint16_t)sizeof strings, NULL, 0};
static const tsa_space_t space = {&table, (uint8_t *)variables, (uint32_t)sizeof variables, NULL, 0};

static void nothing(void) {}

static void sample(void) { recorder_sample(&recorder); }

static void (*volatile measured)(void); /* volatile: not inlined by the compiler */

static uint32_t instructions(void (*function)(void))
{
    measured = function;
    const uint32_t begin = machine_clock();
    measured();
    return machine_instructions(begin, machine_clock());
}

static uint8_t *put_address(uint8_t *to, uint32_t address)
{
    for (; address > 0x7FU; address >>= 7) {
        *to++ = (uint8_t)(0x80U | (address & 0x7FU));
    }
    *to++ = (uint8_t)address;
    return to;
}

static void configure(const case_t *test_case)
{
    uint8_t request[128];
    uint8_t *to = request;
    const recorder_app_t app = {"cost", 0};
    recorder_init(&recorder, &app, &memory);
    memory.owner = NULL;
    const uint8_t head[] = {0x01, 4, test_case->variables, POINTS, 0, test_case->divider};
    for (uint16_t k = 0; k < sizeof head; k++) {
        *to++ = head[k];
    }
    for (uint8_t k = 0; k < test_case->variables; k++) {
        uint8_t *const length = to + 1;
        *to = 0x02;
        to += 2;
        *to++ = k;
        to = put_address(to, TSA_VARIABLES_BASE + 4U * k);
        *to++ = test_case->size;
        *to++ = (k == 0U) ? test_case->trigger : 0U;
        *to++ = 1; /* threshold that is not reached by 0 */
        *length = (uint8_t)(to - length - 1);
    }
    if (test_case->started != 0U) {
        *to++ = START;
        *to++ = 0;
    }
    payload_reader_t operations = {request, (uint16_t)(to - request), false};
    if (fm_is_error(recorder_configure(&recorder, &space, &operations))) {
        machine_stop(1);
    }
}

int main(void)
{
    machine_start();
    for (uint16_t i = 0; i < CASES; i++) {
        uint32_t least = UINT32_MAX;
        uint32_t most = 0;
        uint32_t sum = 0;
        configure(&cases[i]);
        for (uint16_t k = 0; k < CALLS; k++) {
            const uint32_t call = instructions(nothing);
            const uint32_t cost = instructions(sample) - call;
            least = (cost < least) ? cost : least;
            most = (cost > most) ? cost : most;
            sum += cost;
        }
        text_word("", i, " ");
        text_long("", least, " ");
        text_long("", most, " ");
        text_long("", sum, " ");
        text_word("", CALLS, "\n");
    }
    machine_stop(0);
}

/* Interrupts of different priorities that request each other; prints a hash of the order of each round: the referee of the
 * exceptions of servo_twin/native/arm. */
#include <stdint.h>

#include "machine.h"

#define REGISTER(address) (*(volatile uint32_t *)(uintptr_t)(address))
#define ISER REGISTER(0xE000E100u)
#define ICER REGISTER(0xE000E180u)
#define ISPR REGISTER(0xE000E200u)
#define ICPR REGISTER(0xE000E280u)
#define IABR REGISTER(0xE000E300u)
#define PRIORITIES(n) REGISTER(0xE000E400u + 4u * (n))
#define VTOR REGISTER(0xE000ED08u)

#define INTERRUPTS 8u
#define ROUNDS 300u
#define REQUESTS_MAX 24u

static uint32_t table[64] __attribute__((aligned(512)));
static volatile uint32_t random_state = 0x9E3779B9u, sum, requests;

static uint32_t next(void)
{
    uint32_t x = random_state;
    x ^= x << 13;
    x ^= x >> 17;
    x ^= x << 5;
    random_state = x;
    return x;
}

static void note(uint32_t value)
{
    const uint32_t mixed = (sum ^ value) * 0x01000193u;
    sum = mixed ^ mixed >> 15;
}

static void request(uint32_t mask)
{
    __asm__ volatile("str %0, [%1]\n\tdsb\n\tisb" : : "r"(mask), "r"(&ISPR) : "memory");
}

static uint32_t exception(void)
{
    uint32_t number;
    __asm__ volatile("mrs %0, IPSR" : "=r"(number));
    return number;
}

static void handler(void)
{
    const uint32_t number = exception();
    note(number);
    note(IABR);
    note((uint32_t)(uintptr_t)__builtin_return_address(0));
    for (uint32_t more = next() & 3u; more > 0u && requests < REQUESTS_MAX; more--) {
        requests++;
        request(1u << (next() >> 8 & (INTERRUPTS - 1u)));
    }
    note(ISPR);
    note(number + 100u);
}

/* A request within an IT block: the rest of the block is conditional after the handler, too. */
static uint32_t request_in_block(uint32_t mask, uint32_t condition)
{
    uint32_t result = 1;
    __asm__ volatile("cmp %2, #0\n\t"
                     "ittte ne\n\t"
                     "strne %1, [%3]\n\t"
                     "addne %0, #2\n\t"
                     "addne %0, #4\n\t"
                     "addeq %0, #8\n\t"
                     "dsb\n\tisb"
                     : "+r"(result)
                     : "r"(mask), "r"(condition), "r"(&ISPR)
                     : "memory", "cc");
    return result;
}

static void set_mask(uint32_t base) { __asm__ volatile("msr BASEPRI, %0\n\tisb" : : "r"(base) : "memory"); }

static void round_of(void)
{
    sum = 0x811C9DC5u;
    requests = 0;
    for (uint32_t n = 0; n < INTERRUPTS / 4u; n++) {
        PRIORITIES(n) = next() & 0x70707070u;
    }
    ICER = 0xFFu;
    ISER = next() | 1u;
    note(ISER & 0xFFu);
    const uint32_t kind = next() >> 4 & 3u;
    if (kind == 1u) {
        __asm__ volatile("cpsid i" : : : "memory");
    } else if (kind == 2u) {
        set_mask(0x40u);
    }
    request(next() & 0xFFu);
    note(200);
    note(request_in_block(1u << (next() & 7u), next() >> 9 & 1u));
    note(ISPR & 0xFFu);
    ICPR = next() & 0xFFu;
    __asm__ volatile("cpsie i\n\tisb" : : : "memory");
    set_mask(0);
    note(201);
    ISER = 0xFFu;
    __asm__ volatile("dsb\n\tisb" : : : "memory");
    note(202);
}

int main(void)
{
    machine_start();
    for (uint32_t n = 0; n < 16u + INTERRUPTS; n++) {
        table[n] = (uint32_t)(uintptr_t)handler;
    }
    VTOR = (uint32_t)(uintptr_t)table;
    for (uint32_t k = 0; k < ROUNDS; k++) {
        round_of();
        machine_print_hex(sum);
    }
    machine_stop(0);
}

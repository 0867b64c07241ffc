/* startup.c - vector table and reset handler. */
#include "machine.h"

extern uint32_t startup_stack[];
extern uint32_t startup_data[], startup_data_end[], startup_bss[], startup_bss_end[];
extern const uint32_t startup_data_load[];

int main(void);
void startup_reset(void);
void startup_trap(void);

typedef void (*vector_t)(void);

typedef struct {
    const uint32_t *stack;
    vector_t exception[15];
} vectors_t;

__attribute__((section(".vectors"), used)) static const vectors_t vectors = {
    startup_stack,
    {
        startup_reset,
        startup_trap,
        startup_trap,
        startup_trap,
        startup_trap,
        startup_trap,
        startup_trap,
        startup_trap,
        startup_trap,
        startup_trap,
        startup_trap,
        startup_trap,
        startup_trap,
        startup_trap,
        startup_trap,
    },
};

void startup_reset(void)
{
    const uint32_t *from = startup_data_load;
    for (volatile uint32_t *to = startup_data; to < startup_data_end; to++) {
        *to = *from++;
    }
    for (volatile uint32_t *to = startup_bss; to < startup_bss_end; to++) {
        *to = 0;
    }
    machine_stop(main());
}

/* No interrupts are used here: every exception is an error. */
void startup_trap(void)
{
    machine_print("exception\n");
    machine_stop(3);
}

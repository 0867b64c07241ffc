/* The core of servo_twin/native/arm as a machine for test programs: what they use of the mps2-an385 board of QEMU.
 *
 *   simulator PROGRAM.elf IMAGE     text of UART0 to stdout, then the exit status of the program
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "arm/arm.h"
#include "arm/elf.h"

#define PROGRAM_ROOM 0x400000u
#define RAM_BASE 0x20000000u
#define RAM_SIZE 0x400000u
#define IMAGE_BASE 0x21000000u
#define UART_DATA 0x40004000u
#define UART_END 0x40004014u
#define SYSTICK_BASE 0xE000E010u
#define SYSTICK_END 0xE000E01Cu
#define SEMIHOSTING 0xABu
#define EXIT_EXTENDED 0x20u
#define IMAGE_ROOM 0x1000000u
#define SLICE 1000000000

typedef struct {
    arm_t arm;
    int status; /* of the program; below 0: it runs */
} machine_t;

static bool read_register(void *self, uint32_t address, unsigned size, uint32_t *value)
{
    (void)self;
    *value = 0; /* the transmitter is free */
    return size == 4u &&
           ((address >= UART_DATA && address < UART_END) || (address >= SYSTICK_BASE && address < SYSTICK_END));
}

static bool write_register(void *self, uint32_t address, unsigned size, uint32_t value)
{
    uint32_t unused;
    if (address == UART_DATA) {
        (void)putchar((int)(value & 0xFFu));
    }
    return read_register(self, address, size, &unused);
}

/* Semihosting: the program ends. */
static bool breakpoint(void *self, unsigned comment)
{
    machine_t *machine = (machine_t *)self;
    const arm_state_t *state = &machine->arm.state;
    if (comment != SEMIHOSTING || state->r[0] != EXIT_EXTENDED) {
        return false;
    }
    machine->status = (int)arm_load_slow(&machine->arm, state->r[1] + 4u, 4u);
    arm_end_run(&machine->arm);
    return true;
}

static void no_reset(void *self) { arm_fail(&((machine_t *)self)->arm, "a reset is not modelled"); }

static const arm_owner_t owner = {
    .read = read_register, .write = write_register, .breakpoint = breakpoint, .reset = no_reset};

/* With zeros up to `room`. */
static uint8_t *read_file(const char *name, size_t room, size_t *size)
{
    FILE *file = fopen(name, "rb");
    if (file == NULL || fseek(file, 0, SEEK_END) != 0) {
        (void)fprintf(stderr, "%s: cannot be read\n", name);
        exit(2);
    }
    const long length = ftell(file);
    uint8_t *bytes = (uint8_t *)calloc((size_t)length + room, 1);
    (void)fseek(file, 0, SEEK_SET);
    *size = (bytes == NULL) ? 0u : fread(bytes, 1, (size_t)length, file);
    (void)fclose(file);
    return bytes;
}

static int fail(const char *text)
{
    (void)fprintf(stderr, "arm: %s\n", text);
    return 3;
}

int main(int count, char **argument)
{
    static machine_t machine;
    static elf_t elf;
    static arm_region_t regions[] = {
        {.base = 0},
        {.base = RAM_BASE, .size = RAM_SIZE, .writable = true},
        {.base = IMAGE_BASE, .size = IMAGE_ROOM},
    };
    size_t image_size = 0;
    if (count != 3) {
        return fail("PROGRAM.elf IMAGE");
    }
    elf.bytes = read_file(argument[1], 1, &elf.size);
    regions[2].bytes = read_file(argument[2], IMAGE_ROOM, &image_size);
    const char *problem = elf_check(&elf);
    if (problem != NULL) {
        return fail(problem);
    }
    regions[0].size = elf_extent(&elf, 0, PROGRAM_ROOM);
    regions[0].bytes = (uint8_t *)calloc(regions[0].size, 1);
    regions[1].bytes = (uint8_t *)calloc(RAM_SIZE, 1);
    problem = elf_load(&elf, &regions[0]);
    if (problem != NULL) {
        return fail(problem);
    }
    if (!arm_init(&machine.arm, regions, sizeof regions / sizeof regions[0], &owner, &machine)) {
        return fail("no memory");
    }
    machine.status = -1;
    arm_reset(&machine.arm);
    uint64_t cycles = 0;
    while (machine.status < 0) {
        arm_give(&machine.arm, SLICE);
        const arm_stop_t stop = arm_run(&machine.arm);
        cycles += arm_elapsed(&machine.arm);
        if (stop == ARM_FAILED || stop == ARM_RETURNED) {
            (void)fflush(stdout);
            return fail((stop == ARM_FAILED) ? machine.arm.error : "the program returns to nowhere");
        }
        if (machine.arm.state.changed != 0u) {
            arm_give(&machine.arm, 0);
            arm_take_interrupt(&machine.arm);
            cycles += arm_elapsed(&machine.arm);
        }
        if (machine.arm.state.sleeping != 0u && machine.status < 0) {
            return fail("the program sleeps, and nothing wakes it");
        }
    }
    (void)fflush(stdout);
    (void)fprintf(stderr, "arm: %llu instructions, %llu cycles\n", (unsigned long long)machine.arm.state.instructions,
                  (unsigned long long)cycles);
    return machine.status;
}

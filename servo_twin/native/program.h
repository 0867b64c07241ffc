/* program.h - the software of a board as the program of an ELF file, executed instruction by instruction.
 *
 * The chip around the core is a program_chip_t: memory map and registers. Its interrupt vectors are the interrupts of the NVIC, and a
 * cycle of the core is a clock of the chip. An access to a register happens at the clock at which its instruction begins.
 */
#ifndef SERVO_TWIN_PROGRAM_H
#define SERVO_TWIN_PROGRAM_H

#include "app/servo.h"
#include "arm/arm.h"
#include "chip/bus.h"

#define PROGRAM_RAM 0x30000u /* bytes, of all memories of a chip at most */
#define PROGRAM_RAMS 2u

typedef struct {
    uint32_t base, size; /* [bytes] */
} program_memory_t;

/* A chip, apart from its core. */
typedef struct {
    const char *port; /* folder of the port whose programs it executes */
    program_memory_t flash; /* with the vector table out of reset */
    program_memory_t ram[PROGRAM_RAMS]; /* the first has data; sizes of 0 behind the last one */
    program_memory_t
        code_ram; /* most instructions run here, copied from the flash by the program; size 0: in the flash */
    bool flash_is_slow; /* data in the flash is read through `read` */
    /* Access to a register; false: there is none of this size. */
    bool (*read)(void *chip, uint32_t address, unsigned size, uint32_t *value);
    bool (*write)(void *chip, uint32_t address, unsigned size, uint32_t value);
    void (*catch_up)(void *chip); /* at the end of a run; NULL: nothing to do */
    void (*reset)(void *chip); /* by software; NULL: not modelled */
    void (*power_on)(void *chip); /* its reset by the supply; NULL: not modelled */
} program_chip_t;

/* The program starts, out of reset. The handler of a vector begins, or has ended; the result are clocks by which it takes longer. */
typedef struct {
    void (*starts)(void *board);
    void (*begins)(void *board);
    uint32_t (*ends)(void *board, unsigned vector);
} program_hooks_t;

typedef struct program {
    arm_t arm; /* behind its state nothing is part of the state of a board */
    const program_chip_t *kind;
    void *chip; /* first argument of its functions */
    bus_t *bus; /* of the chip */
    const program_hooks_t *hooks;
    bool loaded;
    bool calling;      /* a function runs as by a debugger: no time passes */
    bool timeless;     /* instructions take no time */
    bool initialised;  /* since its reset the software has permitted interrupts: its memory is filled */
    uint64_t identity; /* of the program, for states of boards */
    uint64_t clock;    /* of the next instruction [bus clocks] */
    uint64_t next;     /* clock before which nothing happens; 0: unknown */
    uint32_t servo, snapshot, space, winding[2], read, write, live; /* addresses in the program */
    size_t ram_first, ram_used; /* 0, bytes of the chip; without a program 0 */
    uint8_t ram[PROGRAM_RAM]; /* the memories of the chip, one behind the other */
} program_t;

/* Load an ELF file of the port of this chip. NULL, or why it is refused. `config`: NULL for that of the file. */
const char *program_load(program_t *program, const program_chip_t *kind, void *chip, bus_t *bus,
                         const program_hooks_t *hooks, const uint8_t *elf, size_t size, const servo_config_t *config,
                         uint32_t baud);
void program_free(program_t *program);

/* As chip_run. */
void program_run(program_t *program, uint64_t until);

/* The supply of the chip is too low for some clocks; then the program starts. False: not modelled. */
bool program_brown_out(program_t *program, uint64_t clocks);

/* servo_read and servo_write of the program. FM_BUSY while it starts. */
uint8_t program_read(program_t *program, uint32_t address, uint8_t *data, uint16_t size);
uint8_t program_write(program_t *program, uint32_t address, const uint8_t *data, uint16_t size);

/* tsa_live of the program: where the control loops have a variable of the table. FM_BUSY while it starts. */
uint8_t program_live(program_t *program, uint32_t address, uint16_t size, const uint8_t **found);

/* Place of `size` bytes of its flash or RAM, or NULL. */
uint8_t *program_memory(program_t *program, uint32_t address, size_t size);

/* The telemetry snapshot of the program. */
const uint8_t *program_snapshot(const program_t *program);
uint32_t program_tick(const program_t *program);

/* Hash of its table of variables. */
uint32_t program_contract(const program_t *program);

/* FM_BUSY while it starts. */
uint8_t program_set_winding(program_t *program, int axis, int32_t temperature);

#endif

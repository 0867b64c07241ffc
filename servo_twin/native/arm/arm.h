/* arm.h - a core that executes the instructions of a program for the Cortex-M4 (ARMv7-M with the DSP extension, without
 * floating point).
 *
 * Instructions are decoded once, when they are first reached, and charged with the cycles of one table (cycles.h). The owner
 * gives a number of cycles and gets the core back when they are used up, or before each access to an address that is no
 * memory. What is not modelled is an error that names address, instruction and program counter.
 * The state is flat data: registers, interrupt controller, and the memory, which belongs to the owner.
 */
#ifndef ARM_ARM_H
#define ARM_ARM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#if defined(__GNUC__)
#define ARM_PRINTF(text, first) __attribute__((format(printf, text, first)))
#define NOINLINE __attribute__((noinline)) /* rare paths, so that the loop needs no registers for them */
#else
#define ARM_PRINTF(text, first)
#define NOINLINE
#endif

#define ARM_INTERRUPTS 128u /* external interrupts */
#define ARM_REGIONS 5u
#define ARM_ERROR_SIZE 160u /* bytes */

enum { ARM_SP = 13, ARM_LR = 14, ARM_NOWHERE = 15 }; /* r15 is the place of `op`; its slot takes results of compares */

/* An instruction, decoded. */
typedef struct {
    uint16_t kind; /* operation_t, operations.h */
    uint8_t length; /* [half words] */
    uint8_t cycles; /* without those of a taken branch or a division */
    uint8_t d, n, m, a; /* registers */
    uint32_t imm; /* immediate operand, distance of a branch, mask of registers */
    uint8_t it; /* state of the IT block in front of this instruction, as in the xPSR */
    uint8_t x, y, z; /* shift, condition, width */
} arm_op_t;

/* Memory: bytes in little-endian order, as on the host. The first region is the program; another one may be executed, too. An
 * instruction that has been executed must not be written before the next reset. */
typedef struct {
    uint32_t base, size;
    uint8_t *bytes;
    bool writable;
    bool executable; /* beside the first region */
    bool slow; /* data is read through the owner */
} arm_region_t;

/* Access to an address outside of the regions and of the system control space. `arm_elapsed` cycles have passed since the owner
 * gave cycles. Returns false if there is nothing. */
typedef struct {
    bool (*read)(void *owner, uint32_t address, unsigned size, uint32_t *value);
    bool (*write)(void *owner, uint32_t address, unsigned size, uint32_t value);
    bool (*breakpoint)(void *owner, unsigned comment); /* BKPT; false: an error */
    void (*reset)(void *owner); /* requested by software (AIRCR); does not return */
    void (*entered)(void *owner, unsigned interrupt); /* a handler begins; NULL: nothing to do */
    void (*returned)(void *owner, unsigned interrupt); /* it has ended */
} arm_owner_t;

typedef enum {
    ARM_TIME, /* the cycles are used up, or the interrupts have changed */
    ARM_SLEEPING, /* WFI */
    ARM_RETURNED, /* of a call (arm_call_begin) */
    ARM_FAILED
} arm_stop_t;

typedef struct {
    uint32_t enabled[ARM_INTERRUPTS / 32u];
    uint32_t pending[ARM_INTERRUPTS / 32u];
    uint32_t active[ARM_INTERRUPTS / 32u];
    uint32_t line[ARM_INTERRUPTS / 32u]; /* levels of the request lines */
    uint8_t priority[ARM_INTERRUPTS]; /* a lower number comes first */
} arm_nvic_t;

typedef struct {
    uint32_t r[16]; /* r0..r14 */
    uint32_t pc; /* outside of arm_run */
    uint32_t negative; /* N is bit 31 of this */
    uint32_t nonzero; /* Z: this is 0 */
    uint32_t carry; /* 0 or 1 */
    uint32_t overflow; /* V is bit 31 of this */
    uint32_t saturated; /* Q, 0 or 1 */
    uint32_t ge; /* four flags */
    uint32_t it; /* state of the IT block at `pc` */
    uint32_t exception; /* number of the running exception; 0: thread mode */
    uint32_t primask, basepri, vtor;
    uint32_t sleeping, changed; /* changed: interrupts are to be looked at */
    int32_t given, left; /* cycles */
    uint64_t instructions; /* executed */
    arm_nvic_t nvic;
} arm_state_t;

typedef struct {
    arm_state_t state;
    arm_region_t region[ARM_REGIONS];
    arm_op_t *ops; /* 2 * program_words of them; the second half is for conditional instructions */
    uint32_t program_words; /* half words of both executable regions, and a few behind each */
    uint32_t first_words; /* those of the first region */
    unsigned other; /* index of the other executable region; 0: none */
    uint32_t
        boot; /* address of the vector table out of reset: the base of the first region, unless the owner sets another one */
    const arm_op_t *op; /* the running instruction */
    const arm_owner_t *owner;
    void *self; /* first argument of the owner's functions */
    bool failed;
    char error[ARM_ERROR_SIZE];
} arm_t;

/* False without memory for the decoded program. The region of the program and `self` must stay. */
bool arm_init(arm_t *arm, const arm_region_t *regions, unsigned count, const arm_owner_t *owner, void *self);
void arm_free(arm_t *arm);

/* Stack pointer and program counter from the vector table out of reset. Programs in writable memory are forgotten. */
void arm_reset(arm_t *arm);

/* Execute until `left`, which the owner has set together with `given`, is at or below 0. Overrun cycles make `left` negative. */
arm_stop_t arm_run(arm_t *arm);

static inline uint32_t arm_elapsed(const arm_t *arm) { return (uint32_t)(arm->state.given - arm->state.left); }

/* The same up to where the present instruction begins; within arm_run. */
uint32_t arm_begun(const arm_t *arm);

/* The region of the present instruction; within arm_run. */
const arm_region_t *arm_running_in(const arm_t *arm);

/* Forget the decoded instructions in writable memory: it has been replaced. */
void arm_forget(arm_t *arm);

static inline void arm_give(arm_t *arm, int32_t cycles) { arm->state.given = arm->state.left = cycles; }

/* End arm_run after the present instruction. */
static inline void arm_end_run(arm_t *arm)
{
    arm->state.given -= arm->state.left;
    arm->state.left = 0;
}

/* Levels of the request lines of 64 interrupts from `first` (0 or 64). */
void arm_request(arm_t *arm, unsigned first, uint64_t lines);

/* If an interrupt is due, enter its handler; ends the sleep. Not within arm_run. */
void arm_take_interrupt(arm_t *arm);

/* A function of the program as by a debugger: the caller keeps the state and puts it back afterwards. Set arguments in r[0..3] after
 * this; arm_run ends with ARM_RETURNED. */
void arm_call_begin(arm_t *arm, uint32_t function);

/* Program status as a word, with flags, IT state and exception. */
uint32_t arm_xpsr(const arm_t *arm);
void arm_set_flags(arm_t *arm, uint32_t xpsr);

/* ---- between the files of this folder ------------------------------------------------------------------------------- */

#define ARM_CALL_RETURN 0xFF000000u /* no address of the program */

uint32_t arm_address(const arm_t *arm, const arm_op_t *op);
arm_op_t *arm_slot(const arm_t *arm, uint32_t address); /* of the instruction there; NULL: nothing is executed there */
const arm_region_t *arm_program(const arm_t *arm, uint32_t address); /* the region of an instruction */
void arm_fail(arm_t *arm, const char *format, ...) ARM_PRINTF(2, 3);
arm_op_t *arm_decode(arm_t *arm, uint32_t address, uint32_t it);
bool arm_condition(const arm_state_t *state, unsigned condition);
uint32_t arm_load_slow(arm_t *arm, uint32_t address, unsigned size);
void arm_store_slow(arm_t *arm, uint32_t address, unsigned size, uint32_t value);
bool arm_scs_read(arm_t *arm, uint32_t address, uint32_t *value);
bool arm_scs_write(arm_t *arm, uint32_t address, uint32_t value);
void arm_dsp(arm_t *arm, const arm_op_t *op);
void arm_exception_return(arm_t *arm, uint32_t code); /* sets pc */

#endif

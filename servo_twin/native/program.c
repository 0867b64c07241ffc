#include "program.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "arm/elf.h"
#include "comm/status.h"

#define DATA_BASE 0x60000000u /* of a call: bytes of the host */
#define LOST 0xA5 /* contents of a memory without supply: any */

/* The program is where most instructions run: the flash, or RAM. The flash is behind the RAMs then. */
enum { REGION_PROGRAM, REGION_RAM, REGION_RAM_2, REGION_BOOT, REGION_DATA, REGIONS };
enum { LAYOUT_SNAPSHOT, LAYOUT_SNAPSHOT_SIZE, LAYOUT_WINDING, LAYOUT_SPACE = LAYOUT_WINDING + 2, LAYOUT_WORDS };

/* ---- time ----------------------------------------------------------------------------------------------------------- */

static program_t *program_of(void *self) { return (program_t *)self; }

/* Pass the present levels of the requests on. */
static void update_requests(program_t *program)
{
    bus_t *bus = program->bus;
    if (bus->changed) {
        bus->changed = false;
        arm_request(&program->arm, 0u, bus->request[0]);
        arm_request(&program->arm, 64u, bus->request[1]);
    }
}

/* Handle what happens up to a clock, and pass the time up to there. */
static void handle_events(program_t *program, uint64_t until)
{
    bus_t *bus = program->bus;
    if (until >= program->next || bus->changed) {
        while (bus_step(bus, until, &program->next)) {
        }
        update_requests(program);
    } else if (until > bus->now) {
        bus_pass_time(bus, until);
    }
}

/* The next event may have come nearer. */
static void look_for_events(program_t *program)
{
    const bus_t *bus = program->bus;
    program->next = events_earlier(EVENT_CLOCK(events_next(&bus->events)), bus_next_of_plant(bus));
}

/* Cycles up to a clock, at least one: an instruction begins before it. */
static int32_t cycles_until(uint64_t from, uint64_t clock)
{
    const uint64_t cycles = (clock > from) ? clock - from : 1u;
    return (cycles < INT32_MAX) ? (int32_t)cycles : INT32_MAX;
}

/* Time that instructions have taken, from their cycles. */
static uint64_t taken(const program_t *program, uint32_t cycles) { return program->timeless ? 0u : cycles; }

static const arm_region_t *flash_of(const program_t *program)
{
    return &program->arm.region[(program->kind->code_ram.size > 0u) ? REGION_BOOT : REGION_PROGRAM];
}

/* Before an access: what happens up to the clock at which its instruction begins. */
static void before_access(program_t *program)
{
    if (program->calling || program->arm.op == NULL) { /* by a debugger, or out of reset */
        return;
    }
    if (program->timeless && program->arm.state.primask != 0u) { /* the boot, as that of the linked firmware */
        program->clock += program->bus->access_clocks;
    }
    handle_events(program, program->clock + taken(program, arm_begun(&program->arm)));
}

/* Behind it: the next event may be nearer, and an interrupt may be due. */
static void after_access(program_t *program)
{
    arm_state_t *state = &program->arm.state;
    bus_t *bus = program->bus;
    const uint64_t stall = bus->stall, program_stall = bus->flash_stall;
    bus->stall = bus->flash_stall = 0;
    if (program->calling || program->arm.op == NULL) {
        return;
    }
    program->clock += stall;
    if (program_stall > stall && arm_running_in(&program->arm) == flash_of(program)) {
        program->clock += program_stall - stall;
    }
    update_requests(program);
    if (state->changed != 0u) {
        arm_end_run(&program->arm);
        return;
    }
    const int32_t spent = (int32_t)taken(program, arm_elapsed(&program->arm));
    look_for_events(program);
    state->given = cycles_until(program->clock, events_earlier(program->next, program->bus->limit + 1u));
    state->left = state->given - spent;
}

/* ---- the owner of the core ------------------------------------------------------------------------------------------ */

static bool read_register(void *self, uint32_t address, unsigned size, uint32_t *value)
{
    program_t *program = program_of(self);
    before_access(program);
    const bool found = program->kind->read(program->chip, address, size, value);
    after_access(program);
    return found;
}

static bool write_register(void *self, uint32_t address, unsigned size, uint32_t value)
{
    program_t *program = program_of(self);
    before_access(program);
    const bool found = program->kind->write(program->chip, address, size, value);
    after_access(program);
    return found;
}

static bool no_breakpoint(void *self, unsigned comment)
{
    (void)self;
    (void)comment;
    return false;
}

static void reset_by_software(void *self)
{
    program_t *program = program_of(self);
    if (program->kind->reset == NULL) {
        arm_fail(&program->arm, "a reset by AIRCR is not modelled");
    } else {
        program->kind->reset(program->chip);
    }
}

static void handler_begins(void *self, unsigned interrupt)
{
    program_t *program = program_of(self);
    bus_t *bus = program->bus;
    program->initialised = true;
    bus_note(bus, TRACE_ENTER, interrupt, program->arm.state.nvic.priority[interrupt]);
    program->hooks->begins(bus->board);
}

static void handler_ends(void *self, unsigned interrupt)
{
    program_t *program = program_of(self);
    bus_t *bus = program->bus;
    bus_note(bus, TRACE_LEAVE, interrupt, 0);
    program->clock += program->hooks->ends(bus->board, interrupt);
}

static const arm_owner_t owner = {
    .read = read_register,
    .write = write_register,
    .breakpoint = no_breakpoint,
    .reset = reset_by_software,
    .entered = handler_begins,
    .returned = handler_ends,
};

/* ---- run ------------------------------------------------------------------------------------------------------------ */

static void power_up(program_t *program)
{
    program->bus->must_boot = false;
    program->initialised = false;
    program->clock = program->bus->now;
    arm_reset(&program->arm);
    program->hooks->starts(program->bus->board);
}

bool program_brown_out(program_t *program, uint64_t clocks)
{
    bus_t *bus = program->bus;
    jmp_buf within;
    if (!program->loaded || program->kind->power_on == NULL) {
        return false;
    }
    memcpy(&within, &bus->escape, sizeof within);
    if (!bus->failed && setjmp(bus->escape) == 0) {
        program->kind->power_on(program->chip);
        memset(program->ram, LOST, program->ram_used);
        power_up(program);
        program->clock += clocks;
    }
    memcpy(&bus->escape, &within, sizeof within);
    return true;
}

/* One step of what the core does at its clock. */
static void run_core(program_t *program)
{
    arm_t *arm = &program->arm;
    bus_t *bus = program->bus;
    arm_give(arm, 0);
    if (arm->state.changed != 0u) {
        arm_take_interrupt(arm);
        program->next = 0; /* a handler may have moved the plant */
    } else if (arm->state.sleeping != 0u) {
        (void)bus_step(bus, bus->limit, &program->next);
        program->next = 0;
        program->clock = (program->clock > bus->now) ? program->clock : bus->now;
    } else {
        arm_give(arm, cycles_until(program->clock, events_earlier(program->next, bus->limit + 1u)));
        (void)arm_run(arm);
    }
    program->clock += taken(program, arm_elapsed(arm));
    arm_give(arm, 0);
    if (arm->failed) {
        bus_fail(bus, "%s", arm->error);
    }
}

void program_run(program_t *program, uint64_t until)
{
    bus_t *bus = program->bus;
    bus->limit = until;
    program->next = 0;
    if (bus->failed || setjmp(bus->escape) == ESCAPE_FAILURE) {
        return;
    }
    for (;;) {
        if (bus->must_boot) {
            power_up(program);
        }
        handle_events(program, (program->clock < until) ? program->clock : until);
        if (bus->stop || program->clock > until ||
            (program->arm.state.sleeping != 0u && bus->now >= until && program->arm.state.changed == 0u)) {
            break;
        }
        run_core(program);
    }
    if (program->kind->catch_up != NULL) {
        program->kind->catch_up(program->chip);
    }
}

/* ---- memory --------------------------------------------------------------------------------------------------------- */

static uint8_t *place_in(const arm_region_t *memory, uint32_t address, size_t size)
{
    const uint32_t at = address - memory->base;
    return (at < memory->size && memory->size - at >= size) ? memory->bytes + at : NULL;
}

uint8_t *program_memory(program_t *program, uint32_t address, size_t size)
{
    uint8_t *found = NULL;
    for (unsigned k = 0; program->loaded && k < REGION_DATA && found == NULL; k++) {
        found = place_in(&program->arm.region[k], address, size);
    }
    return found;
}

/* Place of `size` bytes in the RAM of the program, or NULL. */
static const uint8_t *place(const program_t *program, uint32_t address, size_t size)
{
    const uint8_t *found = place_in(&program->arm.region[REGION_RAM], address, size);
    return (found != NULL) ? found : place_in(&program->arm.region[REGION_RAM_2], address, size);
}

/* ---- calls ---------------------------------------------------------------------------------------------------------- */

static bool is_initialised(const program_t *program) { return program->initialised && !program->bus->must_boot; }

/* Result of a function of the program, which finds `data` at DATA_BASE; no time passes. FM_BUSY if it cannot run: until the
 * start of the program is done, its code and variables are not in memory, or those from before the reset. */
static uint32_t call(program_t *program, uint32_t function, const uint32_t argument[4], uint8_t *data, uint16_t size)
{
    arm_t *arm = &program->arm;
    bus_t *bus = program->bus;
    arm_state_t *state = &arm->state;
    const arm_state_t before = *state;
    jmp_buf within;
    volatile uint32_t result = FM_BUSY;
    memcpy(&within, &bus->escape, sizeof within);
    arm->region[REGION_DATA] = (arm_region_t){.base = DATA_BASE, .size = size, .bytes = data, .writable = true};
    program->calling = true;
    if (!bus->failed && is_initialised(program) && setjmp(bus->escape) == 0) {
        bus->polls = 0;
        arm_call_begin(arm, function);
        for (unsigned k = 0; k < 4u; k++) {
            state->r[k] = argument[k];
        }
        arm_give(arm, INT32_MAX);
        if (arm_run(arm) != ARM_RETURNED) {
            bus_fail(bus, "%s", arm->failed ? arm->error : "a function of the program does not return");
        }
        result = state->r[0];
    }
    program->calling = false;
    arm->region[REGION_DATA] = (arm_region_t){.base = DATA_BASE};
    *state = before;
    memcpy(&bus->escape, &within, sizeof within);
    return result;
}

uint8_t program_read(program_t *program, uint32_t address, uint8_t *data, uint16_t size)
{
    return (uint8_t)call(program, program->read, (uint32_t[4]){program->servo, address, DATA_BASE, size}, data, size);
}

uint8_t program_write(program_t *program, uint32_t address, const uint8_t *data, uint16_t size)
{
    const uint32_t argument[4] = {program->servo, address, DATA_BASE, size};
    return (uint8_t)call(program, program->write, argument, (uint8_t *)data, size); /* only read */
}

uint8_t program_live(program_t *program, uint32_t address, uint16_t size, const uint8_t **found)
{
    uint8_t cell[1];
    const uint32_t argument[4] = {program->space, address, size, DATA_BASE};
    if (!is_initialised(program)) {
        return FM_BUSY;
    }
    *found = place(program, call(program, program->live, argument, cell, sizeof cell), size);
    return (*found != NULL) ? FM_OK : FM_DENIED;
}

const uint8_t *program_snapshot(const program_t *program)
{
    return place(program, program->snapshot, sizeof(snapshot_t));
}

uint32_t program_tick(const program_t *program)
{
    uint32_t tick;
    memcpy(&tick, program_snapshot(program) + offsetof(snapshot_t, tick), sizeof tick);
    return tick;
}

uint32_t program_contract(const program_t *program)
{
    uint32_t hash;
    memcpy(&hash, place(program, program->servo + (uint32_t)offsetof(servo_t, catalogue_hash), sizeof hash),
           sizeof hash);
    return hash;
}

uint8_t program_set_winding(program_t *program, int axis, int32_t temperature)
{
    if (!is_initialised(program)) {
        return FM_BUSY;
    }
    memcpy((uint8_t *)place(program, program->winding[axis], sizeof temperature), &temperature, sizeof temperature);
    return FM_OK;
}

/* ---- load ----------------------------------------------------------------------------------------------------------- */

static bool find_symbol(const elf_t *elf, const char *name, uint32_t size, uint32_t *address)
{
    uint32_t found = 0;
    return elf_symbol(elf, name, address, &found) && (size == 0u || found == size);
}

/* Place in the flash of `size` bytes of the program that the program has at this address, or NULL. */
static uint8_t *in_flash(const program_t *program, const elf_t *elf, uint32_t address, size_t size)
{
    uint32_t load;
    return elf_load_address(elf, address, &load) ? place_in(flash_of(program), load, size) : NULL;
}

/* Addresses of what the board reads, and the constants that it sets. */
static bool find_symbols(program_t *program, const elf_t *elf, const servo_config_t *config, uint32_t baud)
{
    uint32_t layout_at, config_at, baud_at, layout[LAYOUT_WORDS];
    if (!find_symbol(elf, "servo", 0u, &program->servo) || !find_symbol(elf, "servo_read", 0u, &program->read) ||
        !find_symbol(elf, "servo_write", 0u, &program->write) || !find_symbol(elf, "tsa_live", 0u, &program->live) ||
        !find_symbol(elf, "image_layout", sizeof layout, &layout_at) ||
        !find_symbol(elf, "servo_config", sizeof *config, &config_at) ||
        !find_symbol(elf, "image_baud", sizeof baud, &baud_at)) {
        return false;
    }
    const uint8_t *numbers = in_flash(program, elf, layout_at, sizeof layout);
    uint8_t *settings = in_flash(program, elf, config_at, sizeof *config),
            *rate = in_flash(program, elf, baud_at, sizeof baud);
    if (numbers == NULL || settings == NULL || rate == NULL) {
        return false;
    }
    memcpy(layout, numbers, sizeof layout);
    program->snapshot = program->servo + layout[LAYOUT_SNAPSHOT];
    program->space = program->servo + layout[LAYOUT_SPACE];
    program->winding[0] = program->servo + layout[LAYOUT_WINDING];
    program->winding[1] = program->servo + layout[LAYOUT_WINDING + 1];
    if (layout[LAYOUT_SNAPSHOT_SIZE] != sizeof(snapshot_t) ||
        place(program, program->servo, sizeof(uint32_t)) == NULL ||
        place(program, program->snapshot, sizeof(snapshot_t)) == NULL ||
        place(program, program->winding[0], 4u) == NULL || place(program, program->winding[1], 4u) == NULL) {
        return false;
    }
    if (config != NULL) {
        memcpy(settings, config, sizeof *config);
    }
    memcpy(rate, &baud, sizeof baud);
    return true;
}

/* Why a program is refused that has other symbols than the port of this chip, which `wrong` then names. */
static const char *wrong_program(char *wrong, size_t size, const program_chip_t *kind)
{
    (void)snprintf(wrong, size,
                   "this is no ELF file of this version of firmware/port/%s: a symbol is missing, or has another size",
                   kind->port);
    return wrong;
}

/* FNV-1a of the program with its constants. */
static uint64_t identity_of(const arm_region_t *flash)
{
    uint64_t sum = UINT64_C(0xCBF29CE484222325);
    for (uint32_t k = 0; k < flash->size; k++) {
        sum = (sum ^ flash->bytes[k]) * UINT64_C(0x100000001B3);
    }
    return sum;
}

const char *program_load(program_t *program, const program_chip_t *kind, void *chip, bus_t *bus,
                         const program_hooks_t *hooks, const uint8_t *elf, size_t size, const servo_config_t *config,
                         uint32_t baud)
{
    const elf_t file = {elf, size};
    const char *problem = elf_check(&file);
    if (problem != NULL) {
        return problem;
    }
    const bool copied = kind->code_ram.size > 0u;
    const unsigned flash = copied ? REGION_BOOT : REGION_PROGRAM;
    arm_region_t regions[REGIONS] = {[REGION_DATA] = {.base = DATA_BASE}};
    uint8_t *ram = program->ram;
    for (unsigned k = 0; k < PROGRAM_RAMS; k++) {
        regions[REGION_RAM + k] =
            (arm_region_t){.base = kind->ram[k].base, .size = kind->ram[k].size, .bytes = ram, .writable = true};
        ram += kind->ram[k].size;
    }
    if (copied) {
        regions[REGION_PROGRAM] =
            (arm_region_t){.base = kind->code_ram.base, .size = kind->code_ram.size, .bytes = ram, .writable = true};
        ram += kind->code_ram.size;
    }
    regions[flash] = (arm_region_t){
        .base = kind->flash.base,
        .size = elf_extent(&file, kind->flash.base, kind->flash.size),
        .executable = copied,
        .slow = kind->flash_is_slow,
    };
    regions[flash].bytes = (uint8_t *)calloc(regions[flash].size + 1u, 1);
    if (regions[flash].bytes == NULL || !arm_init(&program->arm, regions, REGIONS, &owner, program)) {
        free(regions[flash].bytes);
        return "no memory for the program";
    }
    program->arm.boot = kind->flash.base;
    program->kind = kind;
    program->chip = chip;
    program->bus = bus;
    program->hooks = hooks;
    program->ram_used = (size_t)(ram - program->ram);
    program->loaded = true;
    problem = elf_load(&file, flash_of(program));
    if (problem == NULL && !find_symbols(program, &file, config, baud)) {
        problem = wrong_program(program->arm.error, sizeof program->arm.error, kind);
    }
    program->identity = identity_of(flash_of(program));
    return problem;
}

void program_free(program_t *program)
{
    if (program->loaded) {
        free(flash_of(program)->bytes);
        arm_free(&program->arm);
        program->loaded = false;
    }
}

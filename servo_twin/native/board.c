/* Common part of both levels: variables, records, faults, the data flash, samples. */
#include "board_parts.h"

#include <math.h>
#include <string.h>

#include "app/variables.h"
#include "comm/status.h"
#include "config/axis_members.h"
#include "config/servo_config.h"

#define OPERATION_ROOM 24u /* bytes of an operation of SETREC, at most */

void board_servo_config(const board_config_t *config, servo_config_t *servo)
{
    const board_servo_config_t *given = config->servo;
    *servo = servo_config;
    if (given == NULL) {
        return;
    }
    for (uint16_t axis = 0; axis < HAL_AXES; axis++) {
        for (uint16_t k = 0; k < AXIS_MEMBERS; k++) {
            axis_member_set(&servo->axis[axis], k, given->member[axis][k]);
        }
    }
    servo->bus_braking = (bus_braking_config_t){
        .fitted = given->fitted != 0,
        .on = (frac16_t)given->on,
        .off = (frac16_t)given->off,
        .heating = given->heating,
        .cooling = given->cooling,
        .start = (frac16_t)given->start,
        .full = (frac16_t)given->full,
        .u_dc_max_braking = (frac16_t)given->u_dc_max_braking,
    };
    servo->host_timeout = (uint16_t)given->host_timeout;
    servo->command_timeout = (uint16_t)given->command_timeout;
    memcpy(servo->password, given->password, sizeof servo->password);
}

size_t board_snapshot_size(void) { return sizeof(snapshot_t); }

uint8_t board_read(board_t *board, uint32_t address, uint8_t *data, uint16_t size)
{
    return board_software_read(board, address, data, size);
}

uint8_t board_write(board_t *board, uint32_t address, const uint8_t *data, uint16_t size)
{
    return board_software_write(board, address, data, size);
}

uint8_t board_set_winding(board_t *board, int axis, double celsius)
{
    const uint8_t status = board_set_winding_estimate(board, axis, celsius);
    if (status == FM_OK) {
        board_warm_winding(board, axis, celsius);
    }
    return status;
}

uint8_t board_set_winding_estimate(board_t *board, int axis, double celsius)
{
    return board_software_set_winding(board, axis, (frac32_t)(celsius / 256.0 * 2147483648.0));
}

const char *board_drive_shaft(board_t *board, int axis, double theta, double omega, double seconds)
{
    board_truth_t truth;
    (void)board_servo(board);
    board_truth(board, axis, &truth);
    if (!(seconds > 0.0) || !isfinite(seconds)) {
        return "the time of the motion is not above 0 s";
    }
    if (!(fabs(theta - truth.theta_m) <= BOARD_SPEED_MAX * seconds && fabs(omega) <= BOARD_SPEED_MAX)) {
        return "the motion is not a number, or faster than 2000 rad/s";
    }
    if (board_has_second_mass(board, axis)) {
        return "the axis has a second mass (load_inertia), but who drives the shaft owns all inertia; set it to 0";
    }
    driven_shaft_t *shaft = board_driven_shaft(board, axis);
    shaft->braked = shaft->on && shaft->braked && truth.brake_holds != 0.0;
    board_drive_rotor(board, axis, theta, omega, seconds);
    return NULL;
}

double board_brake_torque(board_t *board, int axis, double inertia, double seconds)
{
    const plant_pins_t *pins = board_plant_pins(board, axis);
    driven_shaft_t *shaft = board_driven_shaft(board, axis);
    const bool valid = inertia > 0.0 && isfinite(inertia) && seconds > 0.0 && isfinite(seconds);
    const bool acts = valid && shaft->on && pins->holds && pins->torque > 0.0;
    return acts ? driven_shaft_brake(shaft, pins->torque, inertia, seconds) : 0.0;
}

unsigned board_pins(board_t *board, int axis)
{
    return (board_program_identity(board) != 0) ? ~0u : board_servo(board)->axis[axis].config->pins.fitted;
}

void board_table(uint32_t *address, uint32_t *size)
{
    *address = TSA_TABLE_BASE;
    *size = tsa_table_size(&servo_variables);
}

size_t board_record(board_t *board, uint64_t until_ns, uint8_t *log, size_t max_rows)
{
    size_t rows = 0;
    while (rows < max_rows && board_run_to_tick(board, until_ns)) {
        memcpy(log + rows * sizeof(snapshot_t), board_software_snapshot(board), sizeof(snapshot_t));
        rows++;
    }
    return rows;
}

/* ---- faults ------------------------------------------------------------------------------------------------------- */

void board_inject_fault(board_t *board, const board_fault_t *fault)
{
    (void)board_servo(board); /* a fault comes after the boot */
    if (fault->kind == BOARD_CUT_WIRE) {
        board_cut_wire(board, fault->axis, fault->part, true);
    } else if (fault->kind == BOARD_STALLED_CORE) {
        board_stall_core(board, fault->seconds);
    } else {
        board_set_plant_fault(board, fault, false);
    }
}

void board_clear_fault(board_t *board, const board_fault_t *fault)
{
    if (fault->kind == BOARD_CUT_WIRE) {
        board_cut_wire(board, fault->axis, fault->part, false);
    } else {
        board_set_plant_fault(board, fault, true);
    }
}

/* ---- data flash --------------------------------------------------------------------------------------------------- */

size_t board_flash_size(void) { return FLASH_IMAGE_BYTES; }

void board_flash_state(board_t *board, board_flash_state_t *state)
{
    uint64_t now_ns;
    flash_t *flash = board_flash(board, &now_ns);
    state->busy = flash_busy(flash, now_ns) ? 1 : 0;
    state->dead = flash->dead ? 1 : 0;
    state->commands = flash->commands;
}

void board_flash_image(board_t *board, uint8_t *image)
{
    uint64_t now_ns;
    flash_t *flash = board_flash(board, &now_ns);
    (void)flash_busy(flash, now_ns);
    flash_image(flash, image);
}

void board_flash_cut(board_t *board, uint32_t command, double part)
{
    uint64_t now_ns;
    flash_t *flash = board_flash(board, &now_ns);
    (void)flash_busy(flash, now_ns);
    flash_cut(flash, command, part);
}

void board_flash_cut_now(board_t *board)
{
    uint64_t now_ns;
    flash_t *flash = board_flash(board, &now_ns);
    flash_break_off(flash, now_ns);
    flash->dead = true;
}

/* ---- samples ------------------------------------------------------------------------------------------------------ */

static void put_operation(payload_writer_t *request, uint8_t code, const payload_writer_t *operand)
{
    payload_put_u8(request, code);
    payload_put_u8(request, (uint8_t)operand->size);
    payload_put_bytes(request, operand->data, operand->size);
}

/* The operations of SETREC: as many points as fit, all variables stored, no trigger, no divider; then start. */
static void put_set_up(payload_writer_t *request, const board_cell_t *cell, uint16_t cells)
{
    uint8_t data[OPERATION_ROOM];
    payload_writer_t memory = {data, sizeof data, 0, false};
    payload_put_u8(&memory, (uint8_t)cells);
    for (int k = 0; k < 3; k++) {
        payload_put_unsigned(&memory, 0);
    }
    put_operation(request, 0x01u, &memory);
    for (uint16_t k = 0; k < cells; k++) {
        payload_writer_t slot = {data, sizeof data, 0, false};
        payload_put_u8(&slot, (uint8_t)k);
        payload_put_unsigned(&slot, cell[k].address);
        payload_put_u8(&slot, cell[k].size);
        payload_put_u8(&slot, RECORDER_TYPE_NONE);
        payload_put_unsigned(&slot, 0);
        put_operation(request, 0x02u, &slot);
    }
    const payload_writer_t nothing = {data, sizeof data, 0, false};
    put_operation(request, 0x03u, &nothing);
}

static uint8_t sample_program(board_t *board, board_sampler_t *sampler, int recorder, const board_cell_t *cell,
                              uint16_t cells, uint32_t point, uint32_t *samples, uint32_t points)
{
    board_sampler_t set_up = {.cells = cells, .recorder = recorder, .point = point, .points = points};
    for (uint16_t k = 0; k < cells; k++) {
        const uint8_t status = board_program_place(board, cell[k].address, cell[k].size, &set_up.source[k]);
        set_up.size[k] = cell[k].size;
        if (status != FM_OK) {
            return status;
        }
    }
    if (point == 0u || points == 0u) {
        return FM_BAD_SIZE;
    }
    set_up.samples = (uint8_t *)samples;
    *sampler = set_up;
    return FM_OK;
}

uint8_t board_sample(board_t *board, int recorder, const board_cell_t *cell, uint16_t cells, uint32_t *samples,
                     uint32_t points)
{
    freemaster_t *server = &board_servo(board)->freemaster;
    if (recorder < 0 || recorder >= FREEMASTER_RECORDERS || cells > RECORDER_SLOTS) {
        return FM_BAD_SIZE;
    }
    board_sample_end(board);
    uint32_t point = 0;
    for (uint16_t k = 0; k < cells; k++) {
        point += cell[k].size;
    }
    board_sampler_t *sampler = board_sampler(board);
    if (sampler != NULL) {
        return sample_program(board, sampler, recorder, cell, cells, point, samples, points);
    }
    uint8_t data[(RECORDER_SLOTS + 2) * OPERATION_ROOM];
    payload_writer_t request = {data, sizeof data, 0, false};
    put_set_up(&request, cell, cells);
    server->samples.samples = samples;
    server->samples.size = points * point;
    payload_reader_t operations = {data, request.size, false};
    const uint8_t status = recorder_configure(&server->recorder[recorder], &server->space, &operations);
    if (fm_is_error(status)) {
        board_sample_end(board);
    }
    return status;
}

uint32_t board_sampled(board_t *board, uint32_t *next)
{
    const board_sampler_t *sampler = board_sampler(board);
    if (sampler != NULL) {
        *next = sampler->next;
        return sampler->filled ? sampler->points : sampler->next;
    }
    const recorder_memory_t *memory = &board_servo(board)->freemaster.samples;
    const recorder_sampling_t *sampling = &memory->sampling;
    *next = 0;
    if (memory->owner == NULL || !memory->owner->started) {
        return 0;
    }
    *next = (uint32_t)((size_t)(sampling->next - (const uint8_t *)memory->samples) / sampling->point);
    return sampling->filled ? memory->owner->total : *next;
}

/* The recorders get their own memory again, as after a reset. */
void board_sample_end(board_t *board)
{
    board_sampler_t *sampler = board_sampler(board);
    if (sampler != NULL) {
        *sampler = (board_sampler_t){.samples = NULL};
        return;
    }
    servo_t *servo = board_servo(board);
    freemaster_t *server = &servo->freemaster;
    for (int k = 0; k < FREEMASTER_RECORDERS; k++) {
        const recorder_app_t app = server->recorder[k].app;
        recorder_init(&server->recorder[k], &app, &server->samples);
    }
    server->samples.owner = NULL;
    server->samples.samples = servo->samples;
    server->samples.size = sizeof servo->samples;
}

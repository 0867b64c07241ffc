#include "app/servo.h"

#include "drive/motion.h"
#include "drive/sensorless_estimate.h"

#define MOTOR_1 0
#define MOTOR_2 1

/* Schedule (DRM F34). Each interrupt runs its fast loop first. The remaining work follows it, divided into slots: one
 * per PWM period of the slow tick (eight). A slot is short enough that the next fast loop starts as soon as its samples
 * are ready. All of this runs at one interrupt level: a slot and a fast loop never interrupt each other, so shared data
 * is consistent. */
#define SLOT_SLOW 0U      /* slow loops; then the snapshot */
#define SLOT_PROTECT 1U   /* pins, homing, winding, field */
#define SLOT_ESTIMATE (SERVO_SLOW_PERIODS / 4U)
#define SLOT_CHECK (SLOT_ESTIMATE + 1U)
#define SLOT_MONITOR (SERVO_SLOW_PERIODS / 2U)
#define SLOT_EXCITE (SERVO_SLOW_PERIODS - 2U) /* after the monitors, which may request a test current; feed-forward */
#define SLOT_SUPERVISE (SERVO_SLOW_PERIODS - 2U)
#define SLOT_LATCH (SERVO_SLOW_PERIODS - 1U) /* for the next slow tick: trajectories, then commands */

/* ---- parts of the interrupts ------------------------------------------------------------------------------------------ */

static void note_applied(servo_t *servo)
{
    servo->applied_tick = servo->tick + 1U; /* the slow tick whose M1 follows */
    servo->applied_count++;
}

/* A new configuration is counted, and gets a tick, like any other command. */
static void take_blocks(servo_t *servo)
{
    config_status_t *status = &servo->config_status;
    if (config_blocks_latch(&servo->config_blocks, status, &servo->parameter, &servo->nominal, servo->axis)) {
        note_applied(servo);
        status->taken_tick = servo->applied_tick;
        servo->marks.parameters |= PARAMETERS_RENEWED;
        storage_note_change(&servo->storage);
    }
}

static void latch_commands(servo_t *servo)
{
    if (servo->locked) {
        return;
    }
    if (servo->config_blocks.pending != 0U) { /* commands are latched one tick later: one slot is too short for both */
        take_blocks(servo);
        return;
    }
    if (servo->marks.parameters != 0U) {
        parameters_of_board(&servo->settings, &servo->parameter);
    }
    if (latch_apply(&servo->marks, &servo->command, &servo->parameter, servo->axis)) {
        note_applied(servo);
    }
}

/* Both axes stop with the fault HOST_SILENT if no command and no keep-alive arrives within param.host_timeout.
 * Reads do not restart the timeout, because a client that only monitors does not supervise a motion that another
 * client started. Supervision begins with the first command. */
static void supervise_host(servo_t *servo)
{
    const uint16_t commands = servo->host_commands;
    if (commands != servo->host_commands_seen) {
        servo->host_commands_seen = commands;
        servo->host_idle_ticks = 0;
        servo->host_seen = true;
    } else if (servo->host_idle_ticks < UINT16_MAX) {
        servo->host_idle_ticks++;
    }
    servo->host_silent = servo->host_seen && servo->host_idle_ticks >= servo->settings.host_timeout;
    if (servo->host_silent) {
        for (uint16_t i = 0; i < HAL_AXES; i++) {
            axis_stop_with(&servo->axis[i], FOUND(FINDING_HOST_SILENT));
        }
    }
}

/* The DC bus that both axes share: braking resistor, and limits of the regenerated power. */
static void supervise_bus(servo_t *servo)
{
    bus_braking_t *braking = &servo->bus_braking;
    const bool was_on = braking->on;
    bus_braking_step(braking, &servo->bus_braking_config, servo->settings.brake == 1U, servo->axis[MOTOR_1].u_dc);
    if (braking->on != was_on) {
        hal_brake_resistor(servo->hal, braking->on);
    }
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        axis_t *axis = &servo->axis[i];
        axis->diagnosis.bus.u_dc_max =
            braking->available ? servo->bus_braking_config.u_dc_max_braking : axis->config->u_dc_max;
        axis->regen_derating = braking->regen_derating;
        axis->bus_limits = (uint16_t)(axis->home.refused_limit | axis->ripple.limit |
                                      ((braking->on || braking->exhausted) ? LIMIT_BRAKE : 0U) |
                                      (field_weakening_active(&axis->weakening) ? LIMIT_FIELD_WEAKENING : 0U));
    }
}

static void publish_axis(const axis_t *axis, axis_snapshot_t *view)
{
    view->position = axis->feedback.position;
    view->position_ref = motion_position_ref(axis);
    view->speed = axis->feedback.speed;
    view->speed_ref = axis->motion.speed_ref;
    view->i_q = axis->current_loop.current.q;
    view->i_d = axis->current_loop.current.d;
    view->i_q_ref = axis->current_ref.q;
    view->u_d = axis->current_loop.voltage.d;
    view->u_q = axis->current_loop.voltage.q;
    view->theta_e = axis->feedback.theta_e;
    view->state = (uint16_t)axis->sm.state;
    view->substate = (uint16_t)axis->substate;
    view->faults = axis->latch.captured;
    view->first_fault = axis->latch.first;
    view->limits = axis->active_limits;
    view->points_waiting = trajectory_waiting(&axis->trajectory);
    view->points_taken = axis->trajectory.taken;
    view->points_late = axis->trajectory.late;
    view->winding_temperature = winding_model_shown(&axis->diagnosis.winding);
    view->home_state = axis->home.state;
    view->inputs = axis->inputs;
    view->oscillation = axis->diagnosis.oscillation.frequency;
}

static void publish_estimate(const axis_t *axis, axis_estimate_t *view)
{
    const sensorless_estimate_t *estimate = &axis->estimate;
    if (!estimate->runs) {
        *view = (axis_estimate_t){0};
        return;
    }
    view->speed = estimate->speed;
    view->theta_e = pll_upper(estimate->pll.angle - (uint32_t)estimate->pll.step);
    view->emf = estimate->size;
    view->reliable = estimate->reliable ? 1U : 0U;
}

static void publish_snapshot(servo_t *servo)
{
    if (servo->locked) {
        return;
    }
    snapshot_t *snapshot = &servo->snapshot;
    snapshot->tick = servo->tick;
    snapshot->applied_tick = servo->applied_tick;
    snapshot->applied_count = servo->applied_count;
    snapshot->u_dc = servo->axis[MOTOR_1].u_dc;
    for (uint16_t i = 0; i < HAL_ANALOG_OUTS; i++) {
        snapshot->monitor[i] = servo->monitoring ? servo->monitor[i] : 0;
    }
    snapshot->late_loops = servo->late_loops;
    snapshot->receiver_overruns = hal_receiver_overruns(servo->hal);
    snapshot->points_refused = servo->points_refused;
    snapshot->point_refusal = servo->point_refusal;
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        publish_axis(&servo->axis[i], &snapshot->axis[i]);
        publish_estimate(&servo->axis[i], &servo->estimate.axis[i]);
        servo->record[i].pending = servo->axis[i].latch.pending;
    }
}

static void age(uint16_t *event) { *event = (uint16_t)(*event - ((*event > 0U) ? 1U : 0U)); }

static void age_events(axis_t *axis)
{
    age(&axis->events.command);
    age(&axis->events.mode);
    age(&axis->sm.entered);
}

/* ---- the fast loops --------------------------------------------------------------------------------------------------- */

/* One late or omitted loop is tolerated: the next one compensates for it, and the port restarts its sequence after a
 * lost trigger. More than two within 32 ms are a fault. */
#define LATE UINT16_C(64)
#define LATENESS_MAX UINT16_C(128)

static void count_late_loops(servo_t *servo, uint16_t loops)
{
    servo->late_loops = (uint16_t)(servo->late_loops + loops);
    servo->lateness =
        (loops > LATENESS_MAX) ? (uint16_t)(LATENESS_MAX + 1U) : (uint16_t)(servo->lateness + loops * LATE);
    if (servo->lateness <= LATENESS_MAX) {
        return;
    }
    servo->lateness = 0;
    for (uint16_t i = 0; i < HAL_AXES; i++) {
        axis_raise(&servo->axis[i], FOUND(FINDING_LOOPS_LATE));
    }
}

/* One slow tick. */
static void supervise_loops(servo_t *servo)
{
    const uint16_t loops = hal_late_loops(servo->hal);
    const uint16_t fresh = (uint16_t)(loops - servo->hal_late_loops);
    servo->hal_late_loops = loops;
    servo->lateness = (uint16_t)(servo->lateness - ((servo->lateness > 0U) ? 1U : 0U));
    if (fresh != 0U) {
        count_late_loops(servo, fresh);
    }
}

static uint16_t period_of(uint32_t tick) { return (uint16_t)(tick % SERVO_SLOW_PERIODS); }

/* ---- slots and interrupts ----------------------------------------------------------------------------------------------- */

static void run_axis_slot(axis_t *axis, uint32_t tick)
{
    switch (period_of(tick)) {
    case SLOT_SLOW:
        axis_slow(axis);
        break;
    case SLOT_PROTECT:
        axis_protect(axis);
        break;
    case SLOT_ESTIMATE:
        axis_estimate(axis);
        break;
    case SLOT_CHECK:
        axis_check(axis);
        break;
    case SLOT_MONITOR:
        axis_monitor_currents(axis);
        break;
    case SLOT_MONITOR + 1U:
        axis_monitor_encoder(axis);
        break;
    case SLOT_EXCITE:
        axis_test_signal(axis);
        axis_forward(axis);
        break;
    default: /* SLOT_LATCH is the last one: every slot has a case */
        axis_plan(axis, tick + 1U);
        break;
    }
}

/* Board-wide work after M2: the slots of both axes have run. */
static void run_board_slot(servo_t *servo, uint16_t period)
{
    switch (period) {
    case SLOT_SLOW:
        publish_snapshot(servo);
        recorder_sample(&servo->freemaster.recorder[SERVO_RECORDER_SLOW]);
        break;
    case SLOT_SUPERVISE:
        supervise_host(servo);
        supervise_loops(servo);
        supervise_bus(servo);
        for (uint16_t i = 0; i < HAL_AXES; i++) {
            age_events(&servo->axis[i]);
        }
        hal_watchdog_service(servo->hal); /* reached only while both M1 and M2 run */
        break;
    case SLOT_LATCH:
        latch_commands(servo);
        servo->monitoring = analog_out_selected(&servo->settings);
        break;
    default:
        break;
    }
}

/* The ADC has sampled the currents of motor 1 and the offsets of motor 2 at t0; this runs at t1. */
void servo_m1_isr(servo_t *servo)
{
    servo->tick++;
    axis_fast(&servo->axis[MOTOR_1]);
    hal_duties_done(servo->hal, MOTOR_1);
    if (servo->m2_awaited) {
        count_late_loops(servo, 1); /* M2 was omitted */
    }
    servo->m2_awaited = true;
    run_axis_slot(&servo->axis[MOTOR_2], servo->tick);
}

/* The ADC has sampled the currents of motor 2 and the offsets of motor 1 at t2; this runs at t3. */
void servo_m2_isr(servo_t *servo)
{
    axis_fast(&servo->axis[MOTOR_2]);
    hal_duties_done(servo->hal, MOTOR_2);
    if (servo->monitoring) {
        analog_out_step(&servo->settings, servo->axis, servo->hal, servo->monitor);
    }
    recorder_sample(&servo->freemaster.recorder[SERVO_RECORDER_FAST]);
    if (servo->m2_awaited) {
        servo->m2_awaited = false;
        run_axis_slot(&servo->axis[MOTOR_1], servo->tick);
        run_board_slot(servo, period_of(servo->tick));
    } else {
        count_late_loops(servo, 1); /* M1 was omitted */
    }
}

void servo_edge_isr(servo_t *servo, uint16_t axis) { axis_edge(&servo->axis[axis]); }

void servo_over_current_isr(servo_t *servo, uint16_t axis) { axis_over_current_trip(&servo->axis[axis]); }

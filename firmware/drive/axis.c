/* axis.c - what every state of an axis has in common: measuring, supervising, withdrawing and clearing. */
#include "drive/axis.h"

#include "drive/axis_states.h"
#include "drive/motion.h"

#define U_DC_FILTER_SHIFT 4 /* time constant: 16 PWM periods */
#define BUS_CODE_SHIFT 3    /* 12-bit code to Q1.15 (DRM E46, E47) */

void axis_init(axis_t *axis, const axis_config_t *config, hal_t *hal, uint16_t index, fault_record_t *record,
               const uint32_t *clock)
{
    *record = (fault_record_t){0};
    axis->record = record;
    axis->clock = clock;
    phase_watch_start(&axis->phases);
    encoder_watch_start(&axis->encoder_watch, 0);
    axis->angle_watch = (angle_watch_t){0};
    heat_watch_start(&axis->heat);
    axis->config = config;
    axis->hal = hal;
    axis->index = index;
    axis->source = &encoder_feedback;
    axis->faults = 0;
    axis->faults_enabled = (fault_set_t)PARAM_FAULTS_ENABLED_MAX;
    axis->first_fault = 0;
    axis->limits.speed = config->speed_limit;
    axis->limits.acceleration = config->acceleration_limit;
    axis->limits.i_q = config->i_q_limit;
    axis->path_omega_n_ts = config->path_omega_n_ts;
    axis->features = config->features;
    axis->limits.position_min = -config->position_limit;
    axis->limits.position_max = config->position_limit;
    axis->limits.following_error = config->following_error;
    axis->limits.over_speed = config->over_speed;
    axis->command = (axis_command_t){0};
    axis->feedback = (feedback_t){0};
    axis->search = (rotor_search_t){0};
    axis->proof = (stall_proof_t){0};
    axis->motion = (motion_state_t){0};
    supervision_start(&axis->supervision);
    axis->calibrated = false;
    axis->u_dc_filter = 0;
    axis->u_dc = 0;
    axis->u_dc_most = config->u_dc_most;
    axis->bearable = FRAC16_MAX;
    axis->bus_limits = 0;
    axis->on_disable = (stop_category_t)config->stop.disable;
    axis->on_quick_stop = (stop_category_t)config->stop.quick_stop;
    current_sense_reset(&axis->sense);
    hal_pwm_enable(hal, index, false);
    hal_adc_select(hal, index, axis->sense.pair);
    axis->fast = LOOP_FAST;
    axis->sensorless = false;
    axis->feedback_wanted = config->feedback;
    axis->estimate = (estimate_t){0};
    axis->startup = (startup_t){0};
    axis->source->reset(axis);
    axis_states_init(axis);
}

bool axis_observable(const axis_t *axis) { return axis->config->observer.drive != 0; }

/* Angle and speed come from somewhere else: never in motion, and never from an observer that has no constants. */
static void choose_source(axis_t *axis)
{
    const bool sensorless = axis->feedback_wanted == FEEDBACK_KIND_OBSERVER && axis_observable(axis);
    if (sensorless != axis->sensorless && axis->sm.state != STATE_RUN) {
        axis->sensorless = sensorless;
        axis->source = sensorless ? &observer_feedback : &encoder_feedback;
        axis->source->reset(axis);
    }
}

/* An over-current trips sooner than anything else is seen: it comes first only if nothing is found to be its cause. */
static fault_set_t root_of(const axis_t *axis, fault_set_t faults)
{
    if ((faults & FAULT_OVER_CURRENT) == 0U) {
        return faults;
    }
    const fault_set_t suspects = phase_watch_suspects(&axis->phases) | encoder_watch_suspects(axis);
    return (suspects != 0U) ? suspects & axis->faults_enabled : faults;
}

/* A converter that repeats itself shows within 50 ms, sometimes only after what it has led to. */
#define SECOND_THOUGHTS UINT32_C(2048)

/* The loops are counted once in a slow tick, the over-current that they have let happen is seen at once. */
#define LATE_THOUGHTS UINT32_C(16)

/* Faults that are concluded from currents. */
#define CONCLUSIONS                                                                                                    \
    (FAULT_CURRENT_OFFSET | FAULT_ROTOR_SEARCH | FAULT_ENCODER_LOST | FAULT_ENCODER_REVERSED | FAULT_ANGLE_MISMATCH |  \
     FAULT_PHASE_LOST | FAULT_SPEED_FEEDBACK | FAULT_START_UP)

static void capture(axis_t *axis, fault_set_t faults)
{
    const fault_set_t fresh = faults & ~axis->faults;
    if (fresh == 0U) {
        return;
    }
    if (axis->faults == 0U) {
        const fault_set_t root = root_of(axis, fresh);
        fault_record_first(axis->record, axis, (root != 0U) ? root : fresh);
        axis->faults = root;
    } else if ((fresh & FAULT_CURRENT_SENSE) != 0U && *axis->clock - axis->record->tick < SECOND_THOUGHTS &&
               (axis->faults & (CONCLUSIONS | FAULT_OVER_CURRENT)) != 0U) {
        axis->record->code = fault_code(FAULT_CURRENT_SENSE); /* the controller has been lied to, and so were we */
        axis->faults &= ~CONCLUSIONS;
    } else if ((fresh & FAULT_LATE_LOOP) != 0U && *axis->clock - axis->record->tick < LATE_THOUGHTS &&
               (axis->faults & FAULT_OVER_CURRENT) != 0U) {
        axis->record->code = fault_code(FAULT_LATE_LOOP); /* duties stood still while the shaft went on */
    }
    axis->first_fault = axis->record->code;
    axis->faults |= fresh;
}

void axis_raise(axis_t *axis, fault_set_t faults)
{
    faults &= axis->faults_enabled;
    if (faults != 0U) {
        capture(axis, faults);
        const stop_category_t category = stop_for(&axis->config->stop, faults);
        if (category == STOP_CATEGORY_COAST || !stop_in_hand(axis)) {
            axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_FAULT);
        } else {
            axis->stop_faults |= faults;
            stop_begin(axis, category);
        }
    }
}

void axis_stop_with(axis_t *axis, fault_set_t faults)
{
    if (axis->requested) {
        axis_raise(axis, faults);
    }
}

static void filter_bus(axis_t *axis)
{
    const frac32_t sample = (frac32_t)((uint32_t)hal_adc_bus(axis->hal) << (BUS_CODE_SHIFT + 16));
    frac32_t filter = axis->u_dc_filter;
    if (filter == 0) {
        filter = sample; /* from reset: no rise that looks like under-voltage */
    }
    filter += asr32(sample - filter, U_DC_FILTER_SHIFT);
    axis->u_dc_now = sample;
    axis->u_dc_filter = filter;
    axis->u_dc = f16_from_f32(filter);
}

/* Faults whose cause is there now. */
static fault_set_t present_faults(const axis_t *axis)
{
    fault_set_t faults = 0;
    if (axis->u_dc > axis->u_dc_most) {
        faults |= FAULT_OVER_VOLTAGE;
    }
    if (axis->heat.hot) {
        faults |= FAULT_OVER_TEMPERATURE;
    }
    if (axis->u_dc < axis->config->u_dc_least && axis->sm.state != STATE_INIT) {
        faults |= FAULT_UNDER_VOLTAGE; /* in INIT the filter still settles */
    }
    if (hal_break_active(axis->hal, axis->index)) {
        faults |= FAULT_OVER_CURRENT;
    }
    return faults;
}

/* Quick answer for the fast loop: may there be a fault? */
static bool suspicious(const axis_t *axis)
{
    return axis->u_dc > axis->u_dc_most || axis->u_dc < axis->config->u_dc_least ||
           hal_break_active(axis->hal, axis->index) || axis->faults != 0U;
}

static void watch(axis_t *axis)
{
    if (axis->sm.state == STATE_FAULT) {
        capture(axis, present_faults(axis) & axis->faults_enabled);
        return;
    }
    axis_raise(axis, present_faults(axis));
    if ((axis->faults & ~axis->stop_faults) != 0U) { /* others wait until the axis has been brought to rest */
        axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_FAULT);
    }
}

/* ---- what is watched in the slow loop ---------------------------------------------------------------------------- */

static bool in(const axis_t *axis, substate_t substate)
{
    return axis->sm.state == STATE_RUN && axis->substate == substate;
}

/* Another pair of converters each time: all three say something within three ticks, whatever nobody asks of them. */
static void look_around(axis_t *axis)
{
    axis->sense.pair = (axis->sense.pair == PHASE_PAIR_CA) ? PHASE_PAIR_AB : (phase_pair_t)(axis->sense.pair + 1);
    hal_adc_select(axis->hal, axis->index, axis->sense.pair);
}

/* Of the vector in the last period. */
static frac16_t startup_theta(const axis_t *axis)
{
    const startup_t *startup = &axis->startup;
    if (startup->phase == STARTUP_PROVE) {
        return axis->feedback.theta_e;
    }
    return (startup->phase == STARTUP_RAMP) ? pll_upper(startup->angle - (uint32_t)startup->step) : 0;
}

static fault_set_t watch_phases(axis_t *axis)
{
    if (in(axis, SUBSTATE_ALIGN)) {
        return rotor_search_drives(&axis->search) ? phase_watch_currents(axis, rotor_search_angle(&axis->search)) : 0U;
    }
    if (in(axis, SUBSTATE_SPIN)) {
        return phase_watch_currents(axis, axis->feedback.theta_e);
    }
    if (in(axis, SUBSTATE_STARTUP)) {
        return phase_watch_currents(axis, startup_theta(axis));
    }
    phase_watch_restart(&axis->phases);
    return 0;
}

static fault_set_t watch_encoder(axis_t *axis)
{
    if (axis->sensorless) {
        return 0;
    }
    fault_set_t faults = encoder_watch_count(axis);
    if (in(axis, SUBSTATE_SPIN)) {
        faults |= encoder_watch_voltage(axis) | angle_watch_step(axis);
    } else if (in(axis, SUBSTATE_READY)) {
        faults |= encoder_watch_short(axis);
    }
    return faults;
}

/* Currents, set-points and angle belong to the last period: the fast loop of this one comes afterwards. */
void axis_watch(axis_t *axis)
{
    fault_set_t faults = phase_watch_converters(axis, hal_adc_offsets(axis->hal, axis->index));
    if (axis->sm.state != STATE_RUN) {
        look_around(axis);
    }
    heat_watch_step(&axis->heat, &axis->config->heat, hal_adc_temperature(axis->hal, axis->index));
    const fault_set_t standing = faults | present_faults(axis);
    if (axis->sm.state != STATE_FAULT) {
        faults |= watch_phases(axis); /* by what the encoder showed in the tick before */
        faults |= watch_encoder(axis);
    }
    axis->record->pending = standing;
    axis_raise(axis, faults | (axis->heat.hot ? FAULT_OVER_TEMPERATURE : 0U));
    if (axis->faults == 0U) {
        fault_record_sample(axis->record, axis);
    }
}

void axis_fast(axis_t *axis)
{
    filter_bus(axis);
    axis->source->fast(axis);
    if (suspicious(axis)) {
        watch(axis);
    }
    axis->loop = axis->fast;
    sm_step(&axis->sm, axis);
}

/* A written enable asks for the drive, a written 0 withdraws it; a fault forgets it. */
static void take_requests(axis_t *axis)
{
    const axis_command_t *command = &axis->command;
    if (axis->sm.state == STATE_FAULT) {
        axis->requested = false;
        axis->stop_faults = 0;
    } else if (command->fresh_enable) {
        if (command->enable) {
            axis->requested = axis->stop_faults == 0U;
        } else {
            stop_begin(axis, axis->on_disable);
        }
    }
    if (command->fresh_quick_stop && command->quick_stop && axis->on_quick_stop != STOP_CATEGORY_HOLD) {
        stop_begin(axis, axis->on_quick_stop);
    }
    if (command->clear_faults && axis->sm.state == STATE_FAULT) {
        hal_break_clear(axis->hal, axis->index);
        axis->faults = (axis->record->pending & FAULT_CURRENT_SENSE & axis->faults_enabled) | present_faults(axis);
        axis->first_fault = fault_code(axis->faults);
        if (axis->faults == 0U) {
            axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_FAULT_CLEAR);
        }
    }
}

void axis_slow(axis_t *axis)
{
    axis->active_limits = (uint16_t)(axis->bus_limits | (axis->command.clipped ? LIMIT_SETPOINT : 0U));
    if (!axis->source->slow(axis)) {
        axis_raise(axis, FAULT_ENCODER);
    }
    take_requests(axis);
    choose_source(axis);
    if (axis->sensorless && !(axis->sm.state == STATE_RUN && axis->substate == SUBSTATE_SPIN)) {
        motion_listen(axis);
    }
    if (axis->stop_faults != 0U && !stop_in_hand(axis)) {
        axis->sm.ctrl = (uint16_t)(axis->sm.ctrl | SM_CTRL_FAULT); /* at rest: now the outputs go off */
        axis->stop_faults = 0;
    }
    axis->loop = LOOP_SLOW;
    sm_step(&axis->sm, axis);
}

void axis_edge(axis_t *axis) { axis->source->edge(axis); }

void axis_break(axis_t *axis)
{
    /* The hardware has opened the switches. The fast loop sees its latch and raises the fault; here, above every other
     * interrupt, nothing else may be touched. */
    hal_pwm_enable(axis->hal, axis->index, false);
}

#include "diagnosis/encoder_monitor.h"

#include "config/contract_gen.h"

#define REST_COUNTS 2   /* dither of a shaft at rest */
#define STANDSTILL_TICKS 4U   /* without counts for so long, the shaft is too slow for a back-EMF that matters here */
#define WINDOW 32U      /* slow ticks */
#define TOGGLES_MIN 12U /* changes of the count per window: 375 Hz, faster than any shaft can dither */
#define WINDOWS_MAX 2U
#define UNEXPLAINED_TICKS 8U
#define ROTATION_MAX 16384U /* a quarter of a turn; the criterion is an eighth */
#define TEST_TICKS 4U    /* longer than the settling time of the current controllers */
#define WINDUP_TICKS 60U /* slow ticks of voltage with a constant direction */
#define SHORT_TICKS 8U
#define SETTLED_TICKS 8U  /* settling time of the probing current */
#define PROBE_TICKS 80U   /* total: ends before the speed of the M/T method, without its enhancement, falls to zero */
#define VOLTAGE_CHANGES_MAX 4U

void encoder_monitor_start(encoder_monitor_t *monitor, int32_t count)
{
    *monitor = (encoder_monitor_t){.reference_count = count, .last_count = count};
}

/* ---- the count ---------------------------------------------------------------------------------------------------- */

/* Detects a count that alternates by one, over several windows: a shaft that hunts also does so in a single window. */
static bool single_channel_toggle(encoder_monitor_t *m, int32_t moved)
{
    m->window_ticks++;
    if (moved != 0) {
        m->window_changes++;
        m->not_alternating = m->not_alternating || (moved != -m->last_change && m->last_change != 0);
        m->last_change = moved;
    }
    if (m->window_ticks < WINDOW) {
        return false;
    }
    m->alternating_windows =
        (m->window_changes >= TOGGLES_MIN && !m->not_alternating) ? (uint8_t)(m->alternating_windows + 1U) : 0U;
    m->not_alternating = false;
    m->window_ticks = 0;
    m->window_changes = 0;
    return m->alternating_windows >= WINDOWS_MAX;
}

static uint16_t size_of(int32_t moved)
{
    const uint32_t size = (moved < 0) ? 0U - (uint32_t)moved : (uint32_t)moved;
    return (size > UINT16_MAX) ? UINT16_MAX : (uint16_t)size;
}

static void check_count(encoder_monitor_t *m, const observation_t *o, evidence_t *evidence)
{
    const int32_t count = o->count;
    const int32_t away = i32_sub_wrap(count, m->reference_count);
    const int32_t moved = i32_sub_wrap(count, m->last_count);
    m->last_count = count;
    if (away > REST_COUNTS || away < -REST_COUNTS) {
        const uint16_t earlier = m->step_counts;
        if (m->ticks_without_movement != 0U) { /* otherwise the monitor was restarted in the previous tick */
            encoder_monitor_start(m, count);
        }
        m->reference_count = count;
        m->last_i_q_ref = 0;
        m->step_counts = size_of(moved);
        m->earlier_step_counts = earlier;
        return;
    }
    m->stopped_abruptly =
        m->stopped_abruptly || m->step_counts >= o->abrupt_counts || m->earlier_step_counts >= o->abrupt_counts;
    m->step_counts = 0;
    m->earlier_step_counts = 0;
    if (m->ticks_without_movement < UINT16_MAX) {
        m->ticks_without_movement++;
    }
    if (single_channel_toggle(m, moved)) {
        evidence->confirmed |= FOUND(FINDING_SINGLE_CHANNEL_TOGGLE);
    }
}

/* ---- the voltage -------------------------------------------------------------------------------------------------- */

static int32_t drop(frac16_t current, gain_t resistance)
{
    return f16_from_f32(f32_gain(f32_from_f16(current), resistance));
}

/* Voltage beyond the resistive drop, smoothed by averaging: the noise of a current sample times the controller gain is
 * as large as the back-EMF to be detected. */
static void note_unexplained(encoder_monitor_t *m, gain_t resistance, const observation_t *o)
{
    m->unexplained_voltage.d =
        sat16(asr32((int32_t)m->unexplained_voltage.d + o->voltage.d - drop(o->current.d, resistance), 1));
    m->unexplained_voltage.q =
        sat16(asr32((int32_t)m->unexplained_voltage.q + o->voltage.q - drop(o->current.q, resistance), 1));
}

static bool current_flows(const winding_config_t *config, const observation_t *o)
{
    return o->current_magnitude >= 2 * (int32_t)config->current_min;
}

/* Voltage that half of the resistance, dead time and switches may account for. Dead time is not compensated at small
 * currents. The floor is half of the voltage that a leg loses; without compensation a vector loses up to 4/3 of that of a
 * leg: 8/3 floors, rounded up. */
static int32_t tolerated(const winding_config_t *config, const observation_t *o)
{
    int32_t floors = 3;
    if ((o->features & FEATURE_DEAD_TIME) != 0U) {
        floors = (o->current_magnitude > config->current_min) ? 1 : 2;
    }
    return floors * (int32_t)config->emf_floor + asr32(o->drop, 1);
}

/* The output of integrators in wind-up rotates too, but more slowly than a rotor with a back-EMF of that size.
 * `beyond`: the excess over the tolerated voltage. */
static void note_voltage(encoder_monitor_t *m, const winding_config_t *config, const observation_t *o, int32_t beyond)
{
    const dq_t voltage = m->unexplained_voltage;
    const bool rigid = !m->direction_changed && m->expected_rotation > ROTATION_MAX;
    if (m->unexplained_ticks == 0U || rigid) {
        m->reference_voltage = voltage;
        m->expected_rotation = 0;
        m->direction_changed = false;
        m->ticks_without_current = 0;
        m->direction_was_constant = rigid || (m->unexplained_ticks > 0U && m->direction_was_constant);
    }
    m->expected_rotation += (uint32_t)asr64((int64_t)beyond * config->rotation_per_voltage, 15);
    const int32_t along =
        asr32((int32_t)voltage.d * m->reference_voltage.d, 1) + asr32((int32_t)voltage.q * m->reference_voltage.q, 1);
    const int32_t across =
        asr32((int32_t)voltage.d * m->reference_voltage.q, 1) - asr32((int32_t)voltage.q * m->reference_voltage.d, 1);
    m->direction_changed =
        m->direction_changed || along < across || along < -across; /* more than an eighth of a turn */
    m->ticks_without_current = (uint16_t)(m->ticks_without_current + (current_flows(config, o) ? 0U : 1U));
    m->unexplained_ticks++;
}

static frac16_t test_size(const winding_config_t *config, const observation_t *o)
{
    const int32_t requested = 4 * (int32_t)config->current_min;
    return (requested < o->current_limit) ? (frac16_t)requested : o->current_limit;
}

static void request_test_current(const encoder_monitor_t *m, const winding_config_t *config, const observation_t *o,
                                 evidence_t *evidence)
{
    const frac16_t size = test_size(config, o);
    if (m->along_q) {
        evidence->test_current.q = m->negative_q ? f16_neg(size) : size;
    } else {
        evidence->test_current.d = size;
    }
}

static frac16_t current_along(const encoder_monitor_t *m, const observation_t *o)
{
    return m->along_q ? o->current.q : o->current.d;
}

/* A back-EMF persists under the test current, integrator wind-up does not. A quarter of it is enough: the resistive
 * drop has changed and the resistance may be wrong. If the drop happens to cancel the back-EMF, the rotor turns on and
 * the next test is at another angle. */
static bool emf_persists(const encoder_monitor_t *m)
{
    return 4 * length_about(m->unexplained_voltage.d, m->unexplained_voltage.q) >=
           length_about(m->reference_voltage.d, m->reference_voltage.q);
}

/* The voltage rotates like a back-EMF. It may be integrator wind-up if little current flows or flowed meanwhile, or
 * if the direction of the voltage was constant before for longer than that of a back-EMF. Then a test current is
 * requested along the larger component of the voltage, for the settling time of the current controllers. */
static void test_emf(encoder_monitor_t *m, const winding_config_t *config, const observation_t *o, evidence_t *evidence)
{
    if (m->test_ticks == 0U) {
        if (!m->direction_was_constant && 2 * (int32_t)m->ticks_without_current <= (int32_t)m->unexplained_ticks &&
            current_flows(config, o)) {
            evidence->confirmed |= FOUND(FINDING_EMF_WITHOUT_COUNT);
            return;
        }
        m->along_q = f16_abs(m->unexplained_voltage.q) > f16_abs(m->unexplained_voltage.d);
        m->negative_q = m->along_q && o->current_ref.q > 0;
        m->current_before_test = current_along(m, o);
    }
    m->test_ticks++;
    if (m->test_ticks <= TEST_TICKS) {
        return;
    }
    m->test_ticks = 0;
    const int32_t size = test_size(config, o);
    const int32_t change = (int32_t)current_along(m, o) - m->current_before_test;
    const int32_t more = 4 * (m->negative_q ? -change : change);
    if (more < 2 * size) { /* with a lost phase at most half of the test current flows */
        evidence->confirmed |= FOUND(FINDING_CURRENT_NOT_FOLLOWING);
        return;
    }
    m->unexplained_ticks = 0;
    if (emf_persists(m)) {
        evidence->confirmed |= FOUND((more >= 3 * size) ? FINDING_EMF_CONFIRMED : FINDING_EMF_WITHOUT_COUNT);
    }
}

/* True if a step of the set-point demands a voltage above `emf_floor` through the proportional gain. */
static bool steps(encoder_monitor_t *m, const winding_config_t *config, gain_t kp, const observation_t *o)
{
    const int32_t step = f16_abs(f16_sub(o->current_ref.q, m->last_i_q_ref));
    m->last_i_q_ref = o->current_ref.q;
    return i32_gain(step, kp) > (int32_t)config->emf_floor;
}

/* The count stopped abruptly while little current flows: the encoder may have failed. A back-EMF within the voltage
 * drop of dead time and switches causes no response of the current controllers, so a test current is needed. */
static bool needs_test_current(const encoder_monitor_t *m, const winding_config_t *config, const observation_t *o)
{
    return m->stopped_abruptly && m->test_ticks == 0U && m->ticks_without_movement >= ENCODER_CONFIRM_TICKS &&
           !current_flows(config, o) && f16_abs(o->current_ref.q) < 2 * (int32_t)config->current_min;
}

/* At constant current the voltage is constant, unless the rotor turns. A change of the set-point ends the probe: the
 * response will show whether the shaft moves. */
static void probe(encoder_monitor_t *m, const winding_config_t *config, const observation_t *o, evidence_t *evidence)
{
    const dq_t steady = {f16_from_f32((frac32_t)asr64(o->integrator_d, GAIN_BITS)),
                         f16_from_f32((frac32_t)asr64(o->integrator_q, GAIN_BITS))};
    m->probe_ticks++;
    if (m->probe_ticks <= SETTLED_TICKS) {
        m->along_q = false;
        m->reference_voltage = steady;
        m->i_q_ref_at_probe = o->current_ref.q;
        m->voltage_change_ticks = 0;
        return;
    }
    const bool flows = 4 * (int32_t)current_along(m, o) >= 3 * (int32_t)test_size(config, o);
    const int32_t swing =
        length_about((int32_t)steady.d - m->reference_voltage.d, (int32_t)steady.q - m->reference_voltage.q);
    m->voltage_change_ticks =
        (flows && swing > (int32_t)config->emf_floor / 2) ? (uint8_t)(m->voltage_change_ticks + 1U) : 0U;
    const bool turns = m->voltage_change_ticks >= VOLTAGE_CHANGES_MAX;
    const bool changed = f16_abs(f16_sub(o->current_ref.q, m->i_q_ref_at_probe)) > config->current_min / 2;
    if (turns || changed || m->probe_ticks > PROBE_TICKS) {
        m->probe_ticks = 0;
        m->stopped_abruptly = false;
        m->unexplained_voltage = (dq_t){0, 0};
    }
    if (turns && !changed) {
        evidence->confirmed |= FOUND(FINDING_EMF_WITHOUT_COUNT);
    }
}

/* Evaluate the voltage of one slow tick. */
static void judge(encoder_monitor_t *m, const winding_config_t *config, const observation_t *o)
{
    note_unexplained(m, config->resistance, o);
    const int32_t size = length_about(m->unexplained_voltage.d, m->unexplained_voltage.q);
    const int32_t beyond = size - tolerated(config, o);
    if (beyond > 0) {
        note_voltage(m, config, o, beyond);
    } else if (m->unexplained_ticks > 0U) {
        m->unexplained_ticks--;
        m->ticks_without_current =
            (m->ticks_without_current > m->unexplained_ticks) ? m->unexplained_ticks : m->ticks_without_current;
    }
    const int32_t much = 4 * (int32_t)config->emf_floor + asr32(o->drop, 1);
    m->windup_ticks = (size > much) ? (uint16_t)(m->windup_ticks + 1U) : 0U;
}

/* A voltage that rotates is a back-EMF. A voltage that grows in a constant direction means that no current can flow. */
static void check_voltage(encoder_monitor_t *m, const winding_config_t *config, gain_t kp, const observation_t *o,
                          evidence_t *evidence)
{
    const bool stepped = steps(m, config, kp, o);
    if (m->ticks_without_movement < STANDSTILL_TICKS) {
        m->unexplained_ticks = 0;
        m->windup_ticks = 0;
        return;
    }
    if (m->probe_ticks > 0U || needs_test_current(m, config, o)) {
        probe(m, config, o, evidence);
        return;
    }
    if (!stepped) {
        judge(m, config, o);
    }
    if (m->test_ticks > 0U || (m->unexplained_ticks >= UNEXPLAINED_TICKS && m->direction_changed)) {
        test_emf(m, config, o, evidence);
    } else if (m->windup_ticks >= WINDUP_TICKS) {
        evidence->confirmed |= FOUND(FINDING_CURRENT_NOT_FOLLOWING);
    }
}

/* Shorted windings: current flows only if the shaft turns. */
static void check_shorted(encoder_monitor_t *m, const winding_config_t *config, const observation_t *o,
                          evidence_t *evidence)
{
    const bool flows = o->current_magnitude > 2 * (int32_t)config->current_min;
    m->unexplained_ticks =
        (m->ticks_without_movement >= STANDSTILL_TICKS && flows) ? (uint16_t)(m->unexplained_ticks + 1U) : 0U;
    if (m->unexplained_ticks >= SHORT_TICKS) {
        evidence->confirmed |= FOUND(FINDING_SHORT_CURRENT_WITHOUT_COUNT);
    }
}

void encoder_monitor_step(encoder_monitor_t *m, const winding_config_t *config, gain_t kp, observation_t *o,
                          evidence_t *evidence)
{
    check_count(m, o, evidence);
    o->ticks_without_movement = m->ticks_without_movement;
    if (o->spins) {
        check_voltage(m, config, kp, o, evidence);
        if (m->test_ticks != 0U || m->probe_ticks != 0U) {
            request_test_current(m, config, o, evidence);
        }
    } else if (o->shorted) {
        check_shorted(m, config, o, evidence);
    }
}

void encoder_monitor_suspect(const encoder_monitor_t *m, const observation_t *o, evidence_t *evidence)
{
    if (o->shorted && m->stopped_abruptly) {
        evidence->suspected |= SUSPECT_ENCODER;
    }
}

#include "diagnosis/phase_monitor.h"

/* 4 ms: longer than an intact phase is near zero at speeds at which its current lags the set-point */
#define NO_CURRENT_TICKS 8U
#define NO_RESPONSE_TICKS 40U
#define SUSPECT_TICKS 2U
#define NO_RESPONSE_SUSPECT 8U
#define NO_RESPONSE_FADE_TICKS 4U
#define FORGET_TICKS 16U
#define FADE_TICKS 128U
#define LOW_CURRENT_MAX 14U        /* of FORGET_TICKS: too little current to determine octants */
#define OCTANTS_MIN 6U        /* of 8: an intact phase has no current in at most 4, around its zero crossings */
#define SAMPLES_MIN 32U /* samples without current: small, noisy currents reach 6 octants by chance */
#define SAMPLE 0x100U /* increment of the sample count, which is stored above the octant bits */
#define SUSPECT_OCTANTS 3U /* an intact phase: at most two in a row */

#define STANDSTILL_TICKS 4U /* without counts for so long, the shaft is too slow for a back-EMF that matters here */

/* Magnitudes of the phase currents. */
typedef struct {
    int32_t phase[OBSERVED_PHASES];
    int32_t largest;
} phases_t;

static void restart(phase_monitor_t *m)
{
    for (uint16_t x = 0; x < OBSERVED_PHASES; x++) {
        m->no_current_ticks[x] = 0;
        m->octants[x] = 0;
    }
    m->no_response_ticks = 0;
    m->no_response_count = 0;
    m->lost = false;
    m->last_i_q_ref = 0;
}

static phases_t sizes(dq_t vector, const sin_cos_t *at)
{
    const abc_t x = clarke_inverse(park_inverse(vector, *at));
    phases_t result = {{i32_abs(x.a), i32_abs(x.b), i32_abs(x.c)}, 0};
    for (uint16_t k = 0; k < OBSERVED_PHASES; k++) {
        result.largest = (result.phase[k] > result.largest) ? result.phase[k] : result.largest;
    }
    return result;
}

static uint16_t octant_count(uint16_t octants)
{
    uint16_t count = 0;
    for (uint16_t word = (uint16_t)(octants & (SAMPLE - 1U)); word != 0U; word = (uint16_t)(word & (word - 1U))) {
        count++;
    }
    return count;
}

/* Record the rotor octants in which a phase has no current. Any current in the phase clears the record. */
static void note_octant(phase_monitor_t *m, uint16_t x, uint16_t bit)
{
    m->octants[x] = (uint16_t)(m->octants[x] | bit);
    if (m->octants[x] < SAMPLES_MIN * SAMPLE) {
        m->octants[x] = (uint16_t)(m->octants[x] + SAMPLE);
    } else {
        m->lost = m->lost || octant_count(m->octants[x]) >= OCTANTS_MIN;
    }
}

/* Classify each phase by its current. */
static void note_currents(phase_monitor_t *m, const winding_config_t *config, const phases_t *is, observation_t *o)
{
    const uint16_t bit = (uint16_t)(UINT16_C(1) << ((uint16_t)o->d_axis_angle >> 13));
    for (uint16_t x = 0; x < OBSERVED_PHASES; x++) {
        const int32_t size = is->phase[x];
        if (size >= config->current_min) {
            m->no_current_ticks[x] = 0;
            m->octants[x] = 0;
            o->conducting_phases = (uint16_t)(o->conducting_phases | (UINT16_C(1) << x));
        } else if (2 * size >= config->current_min) {
            m->octants[x] = 0;
        } else if (is->largest > config->direction_current_min) {
            if (3 * size >= is->largest) {
                m->octants[x] = 0;
            } else {
                note_octant(m, x, bit);
            }
        }
    }
}

/* A phase has no current although its set-point is not zero, while other phases conduct: its current is below the certain
 * minimum, or below an eighth of the largest one where half of it is expected. */
static void compare(phase_monitor_t *m, int32_t current_min, const phases_t *is, dq_t current_ref, const sin_cos_t *at)
{
    phases_t set_point = {{0, 0, 0}, 0};
    for (uint16_t x = 0; x < OBSERVED_PHASES; x++) {
        const int32_t size = is->phase[x];
        const bool less = size < current_min && is->largest > 2 * current_min;
        const bool small = 8 * size < is->largest;
        if ((less || small) && set_point.largest == 0) { /* rare */
            set_point = sizes(current_ref, at);
        }
        const int32_t requested = set_point.phase[x];
        if ((less && requested > 2 * current_min) ||
            (small && requested > current_min && requested > set_point.largest / 2)) {
            m->no_current_ticks[x]++;
            m->lost = m->lost || m->no_current_ticks[x] >= NO_CURRENT_TICKS;
        } else if (4 * size >= is->largest) {
            m->no_current_ticks[x] = 0;
        }
    }
}

/* Discard rare samples without current, which occur by chance. */
static void discard(phase_monitor_t *m)
{
    m->age++;
    if (m->age % FORGET_TICKS != 0U) {
        return;
    }
    for (uint16_t x = 0; x < OBSERVED_PHASES; x++) {
        m->no_current_ticks[x] =
            (uint16_t)(m->no_current_ticks[x] - ((m->no_current_ticks[x] > 0U && m->age % FADE_TICKS == 0U) ? 1U : 0U));
        m->octants[x] = (m->low_current_ticks > LOW_CURRENT_MAX) ? 0U : m->octants[x];
    }
    m->low_current_ticks = 0;
}

/* The current stays away from its set-point although the voltage exceeds winding drop and back-EMF. */
static bool current_not_following(const winding_config_t *config, const observation_t *o)
{
    const int32_t emf = o->emf;
    const int32_t windings = o->drop + i32_gain(o->current_change, config->inductance);
    return (o->sensorless || o->ticks_without_movement < STANDSTILL_TICKS) &&
           length_about(o->voltage.d, o->voltage.q - emf) >
               2 * ((int32_t)config->emf_floor + windings) + i32_abs(emf) / 2;
}

/* Only where the back-EMF is that of the frame: a start-up and a search turn the frame themselves. The count decays
 * slowly: set-points of an observer that has lost its rotor are arbitrary. */
static void note_no_response(phase_monitor_t *m, const winding_config_t *config, const observation_t *o,
                             int32_t largest)
{
    const dq_t set_point = o->current_ref;
    const int32_t missing = length_about((int32_t)o->current.d - set_point.d, (int32_t)o->current.q - set_point.q);
    const bool enough = 4 * missing > 3 * (int32_t)config->current_min || missing > config->direction_current_min;
    const bool not_following = enough && current_not_following(config, o);
    m->no_response_ticks = (o->spins && not_following && 4 * missing > 3 * (int32_t)config->current_min)
                               ? (uint16_t)(m->no_response_ticks + 1U)
                               : 0U;
    const bool missed = not_following && 2 * largest < config->current_min && missing > config->direction_current_min;
    if (missed && m->no_response_count < NO_RESPONSE_TICKS) {
        m->no_response_count++;
    } else if (!missed && m->no_response_count > 0U && m->age % NO_RESPONSE_FADE_TICKS == 0U) {
        m->no_response_count--;
    }
}

void phase_monitor_step(phase_monitor_t *m, const winding_config_t *config, observation_t *o, evidence_t *evidence)
{
    o->conducting_phases = 0;
    if (!o->controlled) {
        restart(m);
        return;
    }
    const sin_cos_t at = sin_cos(o->d_axis_angle);
    const phases_t is = sizes(o->current, &at);
    note_currents(m, config, &is, o);
    const bool enough = is.largest > config->direction_current_min;
    const bool same =
        (o->current_ref.q < 0) == (m->last_i_q_ref < 0); /* otherwise the set-point has just changed its sign */
    m->last_i_q_ref = o->current_ref.q;
    if (same && enough && !o->stop_unconfirmed) {
        compare(m, config->current_min, &is, o->current_ref, &at);
    }
    m->low_current_ticks = (uint16_t)(m->low_current_ticks + (enough ? 0U : 1U));
    discard(m);
    note_no_response(m, config, o, is.largest);
    if (m->lost) {
        evidence->confirmed |= FOUND(FINDING_PHASE_NO_CURRENT);
    }
    if (m->no_response_ticks >= NO_RESPONSE_TICKS) {
        evidence->confirmed |= FOUND(FINDING_CURRENT_NOT_FOLLOWING);
    }
}

void phase_monitor_suspect(const phase_monitor_t *m, evidence_t *evidence)
{
    for (uint16_t x = 0; x < OBSERVED_PHASES; x++) {
        if (m->no_current_ticks[x] >= SUSPECT_TICKS || octant_count(m->octants[x]) >= SUSPECT_OCTANTS) {
            evidence->phases_without_current = (uint16_t)(evidence->phases_without_current | (UINT16_C(1) << x));
        }
    }
    if (m->no_response_count >= NO_RESPONSE_SUSPECT) {
        evidence->suspected |= SUSPECT_CURRENT;
    }
}

#include "diagnosis/phase_monitor.h"

/* 4 ms: longer than an intact phase is near zero at speeds at which its current lags the set-point */
#define SILENT_TICKS 8U
#define NOTHING_TICKS 40U
#define SUSPECT_TICKS 2U
#define NOTHING_SUSPECT 8U
#define NOTHING_FADE_TICKS 4U
#define FORGET_TICKS 16U
#define FADE_TICKS 128U
#define FAINT_MAX 14U        /* of FORGET_TICKS: too little current to determine directions */
#define DIRECTIONS 6U        /* of 8: an intact phase is silent in at most 4, around its zero crossings */
#define SILENCES 32U /* number of silent samples required: small, noisy currents reach 6 directions by chance */
#define SILENCE 0x100U /* increment of the sample count, which is stored above the direction bits */
#define SUSPECT_DIRECTIONS 3U /* an intact phase: at most two in a row */

#define CALM_TICKS 4U /* without counts for so long, the shaft is too slow for a back-EMF that matters here */

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

static uint16_t directions(uint16_t sectors)
{
    uint16_t bits = 0;
    for (uint16_t word = (uint16_t)(sectors & (SILENCE - 1U)); word != 0U; word = (uint16_t)(word & (word - 1U))) {
        bits++;
    }
    return bits;
}

/* Record the rotor directions (octants) in which a phase is silent. Any current in the phase clears the record. */
static void note_direction(phase_monitor_t *m, uint16_t x, uint16_t bit)
{
    m->octants[x] = (uint16_t)(m->octants[x] | bit);
    if (m->octants[x] < SILENCES * SILENCE) {
        m->octants[x] = (uint16_t)(m->octants[x] + SILENCE);
    } else {
        m->lost = m->lost || directions(m->octants[x]) >= DIRECTIONS;
    }
}

/* Classify each phase by its current. */
static void note_currents(phase_monitor_t *m, const winding_config_t *config, const phases_t *is, observation_t *o)
{
    const uint16_t bit = (uint16_t)(UINT16_C(1) << ((uint16_t)o->d_axis_angle >> 13));
    for (uint16_t x = 0; x < OBSERVED_PHASES; x++) {
        const int32_t size = is->phase[x];
        if (size >= config->silent) {
            m->no_current_ticks[x] = 0;
            m->octants[x] = 0;
            o->conducting_phases = (uint16_t)(o->conducting_phases | (UINT16_C(1) << x));
        } else if (2 * size >= config->silent) {
            m->octants[x] = 0;
        } else if (is->largest > config->direction_min) {
            if (3 * size >= is->largest) {
                m->octants[x] = 0;
            } else {
                note_direction(m, x, bit);
            }
        }
    }
}

/* A phase is silent although its set-point is not, while other phases conduct: its current is below the certain
 * minimum, or below an eighth of the largest one where half of it is expected. */
static void compare(phase_monitor_t *m, int32_t silent, const phases_t *is, dq_t current_ref, const sin_cos_t *at)
{
    phases_t wanted = {{0, 0, 0}, 0};
    for (uint16_t x = 0; x < OBSERVED_PHASES; x++) {
        const int32_t size = is->phase[x];
        const bool less = size < silent && is->largest > 2 * silent;
        const bool hardly = 8 * size < is->largest;
        if ((less || hardly) && wanted.largest == 0) { /* rare */
            wanted = sizes(current_ref, at);
        }
        const int32_t asked = wanted.phase[x];
        if ((less && asked > 2 * silent) || (hardly && asked > silent && asked > wanted.largest / 2)) {
            m->no_current_ticks[x]++;
            m->lost = m->lost || m->no_current_ticks[x] >= SILENT_TICKS;
        } else if (4 * size >= is->largest) {
            m->no_current_ticks[x] = 0;
        }
    }
}

/* Discard rare silent samples, which occur by chance. */
static void discard(phase_monitor_t *m)
{
    m->age++;
    if (m->age % FORGET_TICKS != 0U) {
        return;
    }
    for (uint16_t x = 0; x < OBSERVED_PHASES; x++) {
        m->no_current_ticks[x] =
            (uint16_t)(m->no_current_ticks[x] - ((m->no_current_ticks[x] > 0U && m->age % FADE_TICKS == 0U) ? 1U : 0U));
        m->octants[x] = (m->low_current_ticks > FAINT_MAX) ? 0U : m->octants[x];
    }
    m->low_current_ticks = 0;
}

/* The current stays away from its set-point although the voltage exceeds winding drop and back-EMF. */
static bool current_not_following(const winding_config_t *config, const observation_t *o)
{
    const int32_t emf = o->emf;
    const int32_t windings = o->drop + i32_gain(o->current_change, config->inductance);
    return (o->sensorless || o->ticks_without_movement < CALM_TICKS) &&
           length_about(o->voltage.d, o->voltage.q - emf) >
               2 * ((int32_t)config->emf_floor + windings) + i32_abs(emf) / 2;
}

/* Only where the back-EMF is that of the frame: a start-up and a search turn the frame themselves. The count decays
 * slowly: set-points of an observer that has lost its rotor are arbitrary. */
static void note_nothing(phase_monitor_t *m, const winding_config_t *config, const observation_t *o, int32_t largest)
{
    const dq_t wanted = o->current_ref;
    const int32_t missing = length_about((int32_t)o->current.d - wanted.d, (int32_t)o->current.q - wanted.q);
    const bool enough = 4 * missing > 3 * (int32_t)config->silent || missing > config->direction_min;
    const bool not_following = enough && current_not_following(config, o);
    m->no_response_ticks = (o->spins && not_following && 4 * missing > 3 * (int32_t)config->silent)
                               ? (uint16_t)(m->no_response_ticks + 1U)
                               : 0U;
    const bool missed = not_following && 2 * largest < config->silent && missing > config->direction_min;
    if (missed && m->no_response_count < NOTHING_TICKS) {
        m->no_response_count++;
    } else if (!missed && m->no_response_count > 0U && m->age % NOTHING_FADE_TICKS == 0U) {
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
    const bool enough = is.largest > config->direction_min;
    const bool same =
        (o->current_ref.q < 0) == (m->last_i_q_ref < 0); /* otherwise the set-point has just changed its sign */
    m->last_i_q_ref = o->current_ref.q;
    if (same && enough && !o->stop_unconfirmed) {
        compare(m, config->silent, &is, o->current_ref, &at);
    }
    m->low_current_ticks = (uint16_t)(m->low_current_ticks + (enough ? 0U : 1U));
    discard(m);
    note_nothing(m, config, o, is.largest);
    if (m->lost) {
        evidence->confirmed |= FOUND(FINDING_PHASE_NO_CURRENT);
    }
    if (m->no_response_ticks >= NOTHING_TICKS) {
        evidence->confirmed |= FOUND(FINDING_CURRENT_NOT_FOLLOWING);
    }
}

void phase_monitor_suspect(const phase_monitor_t *m, evidence_t *evidence)
{
    for (uint16_t x = 0; x < OBSERVED_PHASES; x++) {
        if (m->no_current_ticks[x] >= SUSPECT_TICKS || directions(m->octants[x]) >= SUSPECT_DIRECTIONS) {
            evidence->phases_without_current = (uint16_t)(evidence->phases_without_current | (UINT16_C(1) << x));
        }
    }
    if (m->no_response_count >= NOTHING_SUSPECT) {
        evidence->suspected |= SUSPECT_CURRENT;
    }
}

#include "drive/phase_watch.h"

#include "drive/axis.h"

#define SILENT_TICKS 8  /* 4 ms: longer than any phase is silent at a speed at which currents do not follow */
#define NOTHING_TICKS 40
#define SUSPECT_TICKS 2
#define NOTHING_SUSPECT 8
#define NOTHING_FADE_TICKS 4
#define WINDOW 64       /* samples of a code */
#define NOISE_LEAST 4   /* codes between the extremes of a window: less may be quiet by chance */
#define SAME_BY_CHANCE 16
#define SAME_SUSPECT 6  /* equal codes of a phase that seems silent: 1 in 10000 with a noise of two codes */
#define WRONG_LEAST 32U /* codes off the offset: 16 times the usual noise */
#define WRONG_TICKS 4
#define FORGET_TICKS 16
#define FADE_TICKS 128
#define FAINT_MOST 14   /* of these ticks without enough current to tell directions */
#define DIRECTIONS 6    /* of 8: a whole phase is silent in 4 of them at most, where it changes its sign */
#define SILENCES 32U /* .. and silent so often: small currents that are mostly noise come to 6 directions by chance */
#define SILENCE 0x100U /* one of these: the count stands above the directions */
#define SUSPECT_DIRECTIONS 3 /* of these 2 in a row at most */

void phase_watch_start(phase_watch_t *watch) { *watch = (phase_watch_t){0}; }

void phase_watch_restart(phase_watch_t *watch)
{
    for (uint16_t x = 0; x < SENSE_PHASES; x++) {
        watch->silent[x] = 0;
        watch->sectors[x] = 0;
    }
    watch->nothing = 0;
    watch->missed = 0;
    watch->lost = false;
    watch->wanted = 0;
}

/* ---- converters --------------------------------------------------------------------------------------------------- */

static const uint8_t first_of[SENSE_PHASES] = {0, 1, 2}; /* of phase_pair_t */
static const uint8_t second_of[SENSE_PHASES] = {1, 2, 0};

/* Does a window of codes show noise? */
static void note_spread(phase_watch_t *w, uint16_t x, uint16_t code)
{
    if (w->samples[x] == 0U || code < w->least[x]) {
        w->least[x] = code;
    }
    if (w->samples[x] == 0U || code > w->most[x]) {
        w->most[x] = code;
    }
    w->samples[x]++;
    if (w->samples[x] >= WINDOW) {
        w->noisy[x] = (uint16_t)(w->most[x] - w->least[x]) >= NOISE_LEAST;
        w->samples[x] = 0;
    }
}

static bool others_noisy(const phase_watch_t *w, uint16_t x)
{
    bool noisy = false;
    for (uint16_t y = 0; y < SENSE_PHASES; y++) {
        noisy = noisy || (y != x && w->noisy[y] && w->same[y] < SAME_BY_CHANCE);
    }
    return noisy;
}

static bool frozen(const phase_watch_t *w, uint16_t x, uint16_t least)
{
    return w->same[x] >= least && others_noisy(w, x);
}

/* Something looks wrong already: what seems to be a fault of the motor may be one of its measurement. A single sample may be
 * false without that: its high side has begun with the duty of the period before. */
static bool doubtful(const phase_watch_t *w)
{
    bool doubt = false;
    for (uint16_t x = 0; x < SENSE_PHASES; x++) {
        doubt = doubt || w->wrong[x] > 1U || frozen(w, x, SAME_SUSPECT);
    }
    return doubt;
}

fault_set_t phase_watch_or(const axis_t *axis, fault_set_t fault)
{
    return doubtful(&axis->phases) ? axis_fault_or(axis, FAULT_CURRENT_SENSE, fault) : fault;
}

/* The high sides do conduct in turn. Open switches leave the current of a turning shaft in the diodes. */
static bool switching(const axis_t *axis)
{
    return axis->sm.state == STATE_RUN && axis->substate != SUBSTATE_CALIB && axis->substate != SUBSTATE_FREEWHEEL;
}

/* One code without current; true if the converter is broken. */
static bool broken(axis_t *axis, uint16_t x, uint16_t code)
{
    phase_watch_t *w = &axis->phases;
    if (code != w->last[x]) {
        w->same[x] = 0;
        w->last[x] = code;
    } else if (w->same[x] < UINT16_MAX) {
        w->same[x]++;
    }
    note_spread(w, x, code);
    const uint32_t offset = axis->sense.offset[x] >> SENSE_OFFSET_BITS;
    const bool off = switching(axis) && (code > offset + WRONG_LEAST || code + WRONG_LEAST < offset);
    w->wrong[x] = off ? (uint16_t)(w->wrong[x] + 1U) : 0U;
    return w->wrong[x] >= WRONG_TICKS || frozen(w, x, WINDOW);
}

static bool sample_is_true(const axis_t *axis, uint16_t x)
{
    const frac16_t duty = (frac16_t)((x == 0U)   ? axis->sense.duty.a
                                     : (x == 1U) ? axis->sense.duty.b
                                                 : axis->sense.duty.c);
    return duty >= axis->config->offset_duty_least;
}

fault_set_t phase_watch_converters(axis_t *axis, adc_pair_t codes)
{
    const uint16_t first = first_of[axis->sense.pair];
    const uint16_t second = second_of[axis->sense.pair];
    fault_set_t faults = 0;
    if (sample_is_true(axis, first) && broken(axis, first, codes.first)) {
        faults |= FAULT_CURRENT_SENSE;
    }
    if (sample_is_true(axis, second) && broken(axis, second, codes.second)) {
        faults |= FAULT_CURRENT_SENSE;
    }
    return faults;
}

/* ---- phases ------------------------------------------------------------------------------------------------------- */

typedef struct {
    int32_t phase[SENSE_PHASES];
} phases_t;

/* Sizes of the phase currents of a vector. */
static phases_t sizes(dq_t vector, sin_cos_t at)
{
    const abc_t x = clarke_inverse(park_inverse(vector, at));
    const phases_t result = {{i32_abs(x.a), i32_abs(x.b), i32_abs(x.c)}};
    return result;
}

static int32_t larger(int32_t a, int32_t b) { return (a > b) ? a : b; }

static uint16_t directions(uint16_t sectors)
{
    uint16_t bits = 0;
    for (uint16_t word = (uint16_t)(sectors & (SILENCE - 1U)); word != 0U; word = (uint16_t)(word >> 1)) {
        bits = (uint16_t)(bits + (word & 1U));
    }
    return bits;
}

/* In which directions of the rotor is a phase silent? Once it is not, everything before was by chance. */
static void note_direction(phase_watch_t *w, uint16_t x, int32_t size, int32_t largest, uint16_t bit)
{
    if (3 * size >= largest) {
        w->sectors[x] = 0;
        return;
    }
    w->sectors[x] = (uint16_t)(w->sectors[x] | bit);
    if (w->sectors[x] < SILENCES * SILENCE) {
        w->sectors[x] = (uint16_t)(w->sectors[x] + SILENCE);
    } else {
        w->lost = w->lost || directions(w->sectors[x]) >= DIRECTIONS;
    }
}

/* A phase with less current than `silent`, while the largest one is `largest`. */
static void note_silence(phase_watch_t *w, const phase_watch_config_t *config, uint16_t x, int32_t size,
                         int32_t largest, uint16_t bit)
{
    if (2 * size >= config->silent) {
        w->sectors[x] = 0;
    } else if (largest > config->least) {
        note_direction(w, x, size, largest, bit);
    }
}

/* What came once in a while, by chance, is no evidence. */
static void forget(phase_watch_t *w)
{
    w->age++;
    if (w->age % FORGET_TICKS != 0U) {
        return;
    }
    for (uint16_t x = 0; x < SENSE_PHASES; x++) {
        w->silent[x] = (uint16_t)(w->silent[x] - ((w->silent[x] > 0U && w->age % FADE_TICKS == 0U) ? 1U : 0U));
        w->sectors[x] = (w->faint > FAINT_MOST) ? 0U : w->sectors[x];
    }
    w->faint = 0;
}

/* How far the current is from where the controllers want it. */
static int32_t missing(const axis_t *axis)
{
    const dq_t is = axis->current_loop.current;
    const dq_t wanted = axis->current_ref;
    return length_about((int32_t)is.d - wanted.d, (int32_t)is.q - wanted.q);
}

/* Neither the windings nor the back-EMF are what holds the current back. */
static bool in_vain(const axis_t *axis)
{
    const phase_watch_config_t *config = &axis->config->phases;
    const dq_t u = axis->current_loop.voltage;
    const dq_t is = axis->current_loop.current;
    const int32_t emf = estimate_emf_at(axis, axis->current_loop.omega_e);
    const int32_t drop = i32_gain(length_about(is.d, is.q), config->resistance);
    return (axis->sensorless || axis->encoder_watch.calm < ENCODER_CALM_TICKS) &&
           length_about(u.d, u.q - emf) > 2 * (int32_t)config->emf_floor + larger(emf, -emf) / 2 + 2 * drop;
}

/* As a suspicion it is forgotten slowly: an observer that has lost its rotor asks for anything. */
static void note_nothing(phase_watch_t *w, bool nothing, bool missed)
{
    w->nothing = nothing ? (uint16_t)(w->nothing + 1U) : 0U;
    if (missed && w->missed < NOTHING_TICKS) {
        w->missed++;
    } else if (!missed && w->missed > 0U && w->age % NOTHING_FADE_TICKS == 0U) {
        w->missed--;
    }
}

/* False for a set-point that has only just turned round: the current need not follow yet. */
static bool note_wanted(phase_watch_t *w, frac16_t i_q)
{
    const bool same = (i_q < 0) == (w->wanted < 0);
    w->wanted = i_q;
    return same;
}

static int32_t largest_of(const phases_t *x) { return larger(larger(x->phase[0], x->phase[1]), x->phase[2]); }

/* Current is asked of a phase, the others have some, it has none: less than is certain, or next to nothing of what the
 * others have, instead of half. */
static void compare(phase_watch_t *w, const phase_watch_config_t *config, const phases_t *is, const phases_t *wanted)
{
    const int32_t silent = config->silent;
    const int32_t most = largest_of(is);
    const int32_t most_wanted = largest_of(wanted);
    for (uint16_t x = 0; x < SENSE_PHASES; x++) {
        const bool less = is->phase[x] < silent && most > 2 * silent && wanted->phase[x] > 2 * silent;
        const bool hardly = 8 * is->phase[x] < most && wanted->phase[x] > larger(silent, most_wanted / 2);
        if (less || hardly) {
            w->silent[x]++;
            w->lost = w->lost || w->silent[x] >= SILENT_TICKS;
        } else if (4 * is->phase[x] >= most) {
            w->silent[x] = 0;
        }
    }
}

fault_set_t phase_watch_currents(axis_t *axis, frac16_t theta_e)
{
    phase_watch_t *w = &axis->phases;
    const phase_watch_config_t *config = &axis->config->phases;
    const sin_cos_t at = sin_cos(theta_e);
    const phases_t is = sizes(axis->current_loop.current, at);
    const int32_t largest = largest_of(&is);
    const uint16_t bit = (uint16_t)(UINT16_C(1) << ((uint16_t)theta_e >> 13));
    for (uint16_t x = 0; x < SENSE_PHASES; x++) {
        if (is.phase[x] >= config->silent) {
            w->silent[x] = 0;
            w->sectors[x] = 0;
            w->carried = (uint16_t)(w->carried | (UINT16_C(1) << x));
        } else {
            note_silence(w, config, x, is.phase[x], largest, bit);
        }
    }
    if (note_wanted(w, axis->current_ref.q) && largest > config->least &&
        !encoder_watch_wonders(&axis->encoder_watch)) {
        const phases_t wanted = sizes(axis->current_ref, at);
        compare(w, config, &is, &wanted);
    }
    w->faint = (uint16_t)(w->faint + ((largest > config->least) ? 0U : 1U));
    forget(w);
    const bool vain = in_vain(axis);
    const bool missed = 2 * largest < config->silent && missing(axis) > config->least;
    note_nothing(w, vain && 4 * missing(axis) > 3 * (int32_t)config->silent, vain && missed);
    const bool nothing = w->nothing >= NOTHING_TICKS && axis->substate == SUBSTATE_SPIN; /* the other states search */
    return (w->lost || nothing) ? phase_watch_or(axis, FAULT_PHASE_LOST) : 0U;
}

fault_set_t phase_watch_suspects(const phase_watch_t *watch)
{
    for (uint16_t x = 0; x < SENSE_PHASES; x++) {
        const bool silent = watch->silent[x] >= SUSPECT_TICKS || directions(watch->sectors[x]) >= SUSPECT_DIRECTIONS;
        if (silent && !doubtful(watch) && !frozen(watch, x, SUSPECT_TICKS)) {
            return FAULT_PHASE_LOST;
        }
    }
    return 0;
}

fault_set_t phase_watch_rather(const axis_t *axis, fault_set_t fault)
{
    const phase_watch_t *w = &axis->phases;
    const bool phase = phase_watch_suspects(w) != 0U || w->missed >= NOTHING_SUSPECT;
    return phase_watch_or(axis, phase ? axis_fault_or(axis, FAULT_PHASE_LOST, fault) : fault);
}

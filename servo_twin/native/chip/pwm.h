/* pwm.h - eFlexPWM: two modules of four submodules.
 *
 * A counter is a function of time: `base` at the clock `origin`, one more every 2^prescaler clocks. Distances from the
 * origin take the place of counts, so that INIT and wraps need no special cases: VALk matches at the distance
 * (VALk - base) mod 2^16, and the cycle ends one past the distance of VAL1.
 *
 * Matches that change an output, load registers, fire a trigger or request an interrupt are events; the flags of all others
 * are computed when they are read (`settled`).
 *
 * Within one clock: compares see the values that were active at its beginning; what is loaded at a VAL0 match acts from
 * the next clock on, so a new VAL that equals the count of that very clock is missed. What is loaded at the end of the
 * cycle acts from its first clock on, INIT included.
 */
#ifndef CHIP_PWM_H
#define CHIP_PWM_H

#include "chip/bus.h"

#define PWM_BASE 0xE600u
#define PWM_END 0xE800u

#define PWM_VALS 6
#define PWM_CYCLE 6u /* event behind those of the VALs: one past VAL1 */
#define PWM_WRAP 7u  /* the counter wraps, as nothing has ended the cycle */
#define PWM_EVENTS 8u

typedef struct {
    uint16_t init;          /* [counts] */
    uint16_t val[PWM_VALS]; /* [counts] */
    uint16_t prescaler;     /* 2^prescaler clocks per count */
} pwm_buffered_t;

#define PWM_EVENT(distance, number) ((uint32_t)(distance) * PWM_EVENTS + (number))
#define PWM_EVENT_DISTANCE(event) ((event) / PWM_EVENTS)
#define PWM_EVENT_NUMBER(event) ((event) % PWM_EVENTS)
#define PWM_NO_EVENT UINT32_MAX

/* The list of events is valid, has changed distances, or has other members. It is never valid while the counter is stopped. */
typedef enum { PWM_ORDER_VALID, PWM_ORDER_MOVED, PWM_ORDER_STALE } pwm_order_t;

typedef struct {
    uint8_t id;             /* source of events, and its number in traces: 4 module + number */
    uint8_t module, number; /* 0: A, 1: B; 0 to 3 */
    uint8_t pin[2];         /* gate_pin_t: what drives the pins of the gates, upper and lower */
    /* registers */
    pwm_buffered_t buffer; /* as written */
    pwm_buffered_t active; /* as loaded */
    uint16_t ctrl, ctrl2, octrl, inten, tctrl, dismap0, dismap1;
    uint16_t dtcnt[2];      /* dead times [clocks] */
    uint16_t flags;         /* STS without RUF */
    bool updated;           /* RUF: a buffer was written since the last load */
    unsigned opportunities; /* reload points since the last load, for LDFQ */
    /* counter */
    bool running;
    bool stuck;                    /* a cycle of a single clock: VAL1 == INIT, the state after reset */
    uint64_t origin;               /* clock of distance 0 */
    uint16_t base;                 /* count at distance 0 */
    uint32_t distance[PWM_EVENTS]; /* distance of each event [counts] */
    int64_t done;                  /* events up to this distance are handled [counts] */
    pwm_order_t order;             /* order of the list of events */
    uint32_t event[PWM_EVENTS + 1]; /* events of a cycle: PWM_EVENT(distance, number), rising; ends with PWM_NO_EVENT */
    const uint32_t *next; /* first event that is not handled */
    int64_t settled; /* flags up to this distance are found [counts] */
    unsigned plain; /* bit k: VALk only switches the pair */
    unsigned eventful; /* bit k: VALk is an event */
    uint64_t next_clock; /* time of the next event of the counter */
    uint64_t sync_clock; /* time at which a pulse at EXT_SYNC takes effect; CHIP_NEVER: none */
    /* outputs, bit 0 A and bit 1 B; generated, followed and given: bit 0 PWM23, bit 1 PWM45 */
    unsigned generated;
    unsigned followed; /* DTSRCSEL in force: generated signals that the outputs follow */
    unsigned given; /* DTSRCSEL in force: inversion, or SWCOUT */
    unsigned mask; /* MASK in force */
    bool from_45; /* IPOL: the pair follows PWM45 */
    bool pair; /* input of the dead-time unit */
    unsigned out; /* outputs of the dead-time unit, or of an independent submodule */
    uint64_t dead_clock; /* end of the dead time in progress; CHIP_NEVER without one */
    unsigned blocked; /* bit per fault that disables the outputs */
    unsigned live; /* pins that follow the outputs */
    unsigned fixed; /* levels of the other pins, or inversion */
    unsigned levels; /* levels of the pins: bit 0 upper, bit 1 lower switch */
} pwm_submodule_t;

typedef struct {
    pwm_submodule_t sub[PWM_SUBMODULES];
    uint16_t reg[14]; /* OUTEN to FTST1; those of faults 4-7 are stored only */
    uint16_t ldok, run, ipol; /* fields of MCTRL, bit per submodule */
    uint16_t fsts_full, fsts_half; /* fields of FSTS0, bit per fault */
    unsigned fault_flag; /* FFLAG */
    unsigned fault_pin; /* levels of the inputs, bit per input */
    unsigned fault_filtered; /* levels behind the filters */
    uint64_t fault_clock[PWM_FAULTS]; /* at which a new level passes its filter; CHIP_NEVER without one */
    unsigned fault_active; /* bit per input: filtered level means a fault */
    uint32_t locked_writes; /* lost because LDOK was set */
} pwm_module_t;

typedef struct {
    bus_t *bus;
    pwm_submodule_t *submodule[PWM_MODULES * PWM_SUBMODULES]; /* by source of events */
    pwm_module_t module[PWM_MODULES];
} pwm_t;

uint16_t pwm_read(void *pwm, uint32_t address);
void pwm_write(void *pwm, uint32_t address, uint16_t value);
void pwm_reset(void *pwm);
void pwm_event(void *pwm, unsigned source);
void pwm_fault_event(void *pwm, unsigned source);

/* Pulse at EXT_SYNC; its delay is added. */
void pwm_ext_sync(pwm_t *pwm, unsigned module, unsigned submodule);

/* Level at a fault input. */
void pwm_fault_input(pwm_t *pwm, unsigned module, unsigned input, bool level);

/* `pin` of the submodules has changed. */
void pwm_pins_changed(pwm_t *pwm);

/* The clock gates in the SIM have changed. */
void pwm_gates_changed(pwm_t *pwm);

#endif

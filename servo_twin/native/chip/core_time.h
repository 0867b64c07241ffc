/* core_time.h - charges: how the software reports the time it takes to the core that runs it.
 *
 * The build puts a charge in front of each statement of the firmware (servo_twin/_core_time.py). Charges are
 * deducted from the time until the next event; when that is used up the core handles the event, and interrupts. An access
 * to a register comes after all earlier charges. Outside of chip_run charges have no effect.
 */
#ifndef CHIP_CORE_TIME_H
#define CHIP_CORE_TIME_H

/* One variable per thread, located anew at each access: a run that is suspended in one thread may continue in another. */
#define CORE_THREAD __thread __attribute__((tls_model("initial-exec")))

/* Charge left until core_look is to be called [1/16 instruction]. A thread runs one chip at a time. */
extern CORE_THREAD int core_left;

void core_look(void);

/* x86 addresses the variable by a segment register at each access; elsewhere a compiler may keep its address over a change of
 * the thread, therefore the call. */
#if defined(__x86_64__)
static inline void core_spend(int units)
{
    core_left -= units;
    if (core_left < 0) {
        core_look();
    }
}
#else
void core_spend(int units);
#endif

#endif

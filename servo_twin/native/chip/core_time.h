/* core_time.h - how the software tells the core that runs it how far it has got.
 *
 * The build puts a charge in front of each statement of the firmware (servo_twin/_core_time.py). A charge is paid from
 * what the core has given until the next event; when that is spent the core lets time pass, and interrupts come. Every
 * access to a register settles what has been spent before. Outside of chip_run charges mean nothing.
 */
#ifndef CHIP_CORE_TIME_H
#define CHIP_CORE_TIME_H

/* Of a thread, found anew at each access: a run that is suspended in one thread may go on in another one. */
#define CORE_THREAD __thread __attribute__((tls_model("initial-exec")))

/* Units of 1/16 instruction until the core has to look. A thread runs one chip at a time. */
extern CORE_THREAD int core_left;

void core_look(void);

/* A suspended handler may go on in another thread. x86 finds the variable by a segment register at each access; elsewhere
 * a compiler may keep its address, therefore the call. */
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

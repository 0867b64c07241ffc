/* clock.c - start of crystal and PLL, in an order in which the core never loses its clock. */
#include "port/mc56f84789/drivers.h"

#define POLLS_MAX 60000U
#define SWITCH_NOPS 6U /* duration of a change of the reference */

bool wait_for(hal_t *hal, uint16_t address, uint16_t mask, uint16_t value)
{
    for (uint16_t polls = 0; polls < POLLS_MAX; polls++) {
        if ((REG_READ(hal, address) & mask) == value) {
            return true;
        }
    }
    return false;
}

/* The internal oscillator clocks the watchdog: set it to the frequency that the factory measured. */
static void trim(hal_t *hal)
{
    const uint16_t factory = REG_READ(hal, SIM_NVMOPT2H);
    const uint16_t osctl1 = REG_READ(hal, OCCS_OSCTL1);
    const uint16_t osctl2 = REG_READ(hal, OCCS_OSCTL2);
    REG_WRITE(hal, OCCS_OSCTL1,
              (osctl1 & (uint16_t)~OCCS_OSCTL1_FREQ_TRIM8M_MASK & (uint16_t)~OCCS_OSCTL1_ROPD) |
                  OCCS_OSCTL1_FREQ_TRIM8M(FIELD_GET(factory, SIM_NVMOPT2H_FREQ_TRIM8M_MASK)));
    REG_WRITE(hal, OCCS_OSCTL2,
              (osctl2 & (uint16_t)~OCCS_OSCTL2_TEMP_TRIM8M_MASK) |
                  OCCS_OSCTL2_TEMP_TRIM8M(FIELD_GET(factory, SIM_NVMOPT2H_TEMP_TRIM8M_MASK)));
}

bool clock_init(hal_t *hal)
{
    trim(hal);

    /* Back to the oscillator that is active after reset, PLL off. */
    REG_WRITE(hal, OCCS_CTRL, OCCS_CTRL_PRECS(OCCS_PRECS_INTERNAL) | OCCS_CTRL_PLLPD);
    if (!wait_for(hal, OCCS_STAT, OCCS_STAT_ZSRCS_MASK, OCCS_STAT_ZSRCS(OCCS_ZSRCS_OSCILLATOR))) {
        return false;
    }

    /* Crystal, not an external clock. */
    const uint16_t osctl1 = REG_READ(hal, OCCS_OSCTL1);
    REG_WRITE(hal, OCCS_OSCTL1, osctl1 & (uint16_t)~(OCCS_OSCTL1_EXT_SEL | OCCS_OSCTL1_CLK_MODE));
    const uint16_t osctl2 = REG_READ(hal, OCCS_OSCTL2);
    REG_WRITE(hal, OCCS_OSCTL2, osctl2 & (uint16_t)~OCCS_OSCTL2_COPD);
    if (!wait_for(hal, OCCS_STAT, OCCS_STAT_OSC_OK, OCCS_STAT_OSC_OK)) {
        return false;
    }
    REG_WRITE(hal, OCCS_CTRL, SET_OCCS_CTRL_CRYSTAL);
    for (uint16_t i = 0; i < SWITCH_NOPS; i++) {
        (void)REG_READ(hal, OCCS_STAT);
    }

    REG_WRITE(hal, OCCS_DIVBY, SET_OCCS_DIVBY);
    REG_WRITE(hal, OCCS_CTRL, SET_OCCS_CTRL_PLL | OCCS_CTRL_PLLPD); /* the lock detector first */
    REG_WRITE(hal, OCCS_CTRL, SET_OCCS_CTRL_PLL);
    if (!wait_for(hal, OCCS_STAT, OCCS_STAT_LCK0, OCCS_STAT_LCK0) ||
        !wait_for(hal, OCCS_STAT, OCCS_STAT_LCK1, OCCS_STAT_LCK1)) {
        return false;
    }
    REG_WRITE(hal, OCCS_CTRL, SET_OCCS_CTRL_RUN);
    return wait_for(hal, OCCS_STAT, OCCS_STAT_ZSRCS_MASK, OCCS_STAT_ZSRCS(OCCS_ZSRCS_PLL));
}

/* clock.c - crystal and PLL, clock gates, watchdog. */
#include "port/stm32f405/drivers.h"

#define POLLS_MAX 1000000U

bool wait_for(hal_t *hal, uint32_t address, uint32_t mask, uint32_t value)
{
    for (uint32_t polls = 0; polls < POLLS_MAX; polls++) {
        if ((REG_READ(hal, address) & mask) == value) {
            return true;
        }
    }
    return false;
}

void wait_clocks(hal_t *hal, uint32_t duration)
{
    const uint32_t from = clocks(hal);
    while (clocks(hal) - from < duration) {
    }
}

static void start_counter(hal_t *hal)
{
    REG_WRITE(hal, TIM5_BASE + TIM_PSC, 0U);
    REG_WRITE(hal, TIM5_BASE + TIM_ARR, UINT32_C(0xFFFFFFFF));
    REG_WRITE(hal, TIM5_BASE + TIM_CR1, TIM_CR1_CEN);
}

/* Back to the internal oscillator. A boot loader may have left the PLL on, as the system clock: then it cannot be
 * switched off, and while it is on, its settings and the voltage scale cannot be changed. */
static bool leave_pll(hal_t *hal)
{
    const uint32_t cr = REG_READ(hal, RCC_BASE + RCC_CR) | RCC_CR_HSION;
    REG_WRITE(hal, RCC_BASE + RCC_CR, cr);
    if (!wait_for(hal, RCC_BASE + RCC_CR, RCC_CR_HSIRDY, RCC_CR_HSIRDY)) {
        return false;
    }
    REG_WRITE(hal, RCC_BASE + RCC_CFGR, 0U);
    if (!wait_for(hal, RCC_BASE + RCC_CFGR, FIELD_MASK(RCC_CFGR_SWS), RCC_CFGR_SWS(RCC_CFGR_SW_HSI))) {
        return false;
    }
    REG_WRITE(hal, RCC_BASE + RCC_CR, cr & ~(RCC_CR_PLLON | RCC_CR_CSSON));
    return wait_for(hal, RCC_BASE + RCC_CR, RCC_CR_PLLRDY, 0U);
}

/* Wait states and dividers before the higher clock. A failure of the crystal raises the non-maskable interrupt. */
bool clock_init(hal_t *hal)
{
    if (!leave_pll(hal)) {
        return false;
    }
    REG_WRITE(hal, RCC_BASE + RCC_AHB1ENR, SET_RCC_AHB1ENR);
    REG_WRITE(hal, RCC_BASE + RCC_APB1ENR, SET_RCC_APB1ENR);
    REG_WRITE(hal, RCC_BASE + RCC_APB2ENR, SET_RCC_APB2ENR);
    (void)REG_READ(hal, RCC_BASE + RCC_APB2ENR); /* a gate opens two clocks after the write */
    REG_WRITE(hal, PWR_BASE + PWR_CR, REG_READ(hal, PWR_BASE + PWR_CR) | PWR_CR_VOS);

    const uint32_t cr = REG_READ(hal, RCC_BASE + RCC_CR);
    REG_WRITE(hal, RCC_BASE + RCC_CR, cr | RCC_CR_HSEON);
    if (!wait_for(hal, RCC_BASE + RCC_CR, RCC_CR_HSERDY, RCC_CR_HSERDY)) {
        return false;
    }
    REG_WRITE(hal, RCC_BASE + RCC_PLLCFGR, SET_RCC_PLLCFGR);
    REG_WRITE(hal, RCC_BASE + RCC_CR, cr | RCC_CR_HSEON | RCC_CR_PLLON);
    if (!wait_for(hal, RCC_BASE + RCC_CR, RCC_CR_PLLRDY, RCC_CR_PLLRDY)) {
        return false;
    }
    REG_WRITE(hal, FLASH_BASE + FLASH_ACR, SET_FLASH_ACR);
    if (!wait_for(hal, FLASH_BASE + FLASH_ACR, FIELD_MASK(FLASH_ACR_LATENCY), FLASH_ACR_LATENCY(FLASH_WAIT_STATES))) {
        return false;
    }
    REG_WRITE(hal, RCC_BASE + RCC_CFGR, SET_RCC_CFGR_DIVIDERS);
    REG_WRITE(hal, RCC_BASE + RCC_CFGR, SET_RCC_CFGR);
    if (!wait_for(hal, RCC_BASE + RCC_CFGR, FIELD_MASK(RCC_CFGR_SWS), RCC_CFGR_SWS(RCC_CFGR_SWS_PLL))) {
        return false;
    }
    REG_WRITE(hal, RCC_BASE + RCC_CR, cr | RCC_CR_HSEON | RCC_CR_PLLON | RCC_CR_CSSON);
    start_counter(hal);
    return true;
}

/* ---- watchdog: it cannot be stopped, except by a debugger that holds the core ------------------------------------ */

/* While a debugger holds the core, the carriers stop, with open switches, and the clock of the loops: none is late behind it. */
void debug_freeze(hal_t *hal, bool watchdog)
{
    REG_WRITE(hal, DBGMCU_BASE + DBGMCU_APB1_FZ, DBGMCU_APB1_FZ_TIM5 | (watchdog ? DBGMCU_APB1_FZ_IWDG : 0U));
    REG_WRITE(hal, DBGMCU_BASE + DBGMCU_APB2_FZ, DBGMCU_APB2_FZ_TIM1 | DBGMCU_APB2_FZ_TIM8);
}

void watchdog_start(hal_t *hal)
{
    REG_WRITE(hal, IWDG_BASE + IWDG_KR, IWDG_KR_START);
    REG_WRITE(hal, IWDG_BASE + IWDG_KR, IWDG_KR_UNLOCK);
    REG_WRITE(hal, IWDG_BASE + IWDG_PR, SET_IWDG_PR);
    REG_WRITE(hal, IWDG_BASE + IWDG_RLR, SET_IWDG_RLR);
    (void)wait_for(hal, IWDG_BASE + IWDG_SR, IWDG_SR_PVU | IWDG_SR_RVU, 0U); /* without it, it is longer: still on */
    hal_watchdog_service(hal);
}

void hal_watchdog_service(hal_t *hal) { REG_WRITE(hal, IWDG_BASE + IWDG_KR, IWDG_KR_SERVICE); }

bool hal_reset_by_watchdog(hal_t *hal) { return hal->watchdog_reset; }

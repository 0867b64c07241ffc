/* Frequencies other than 168 MHz of the core, 42 and 84 MHz of the buses are not modelled: they are refused where the PLL becomes
 * the system clock. Before, instructions take the time that they take at 168 MHz. */
#include "stm32f405/rcc.h"

#include "port/stm32f405/registers.h"

#define NAME "RCC"
#define PWR_NAME "PWR"

enum { AHB1RSTR = 0x10, APB1RSTR = 0x20, APB2RSTR = 0x24 }; /* which the port does not use */
enum { PWR_CSR = 0x04 }; /* which the port does not use */

#define CR_WRITABLE (RCC_CR_HSION | 0xF8u | RCC_CR_HSEON | RCC_CR_CSSON | RCC_CR_PLLON)
#define CFGR_BUSES (FIELD_MASK(RCC_CFGR_HPRE) | FIELD_MASK(RCC_CFGR_PPRE1) | FIELD_MASK(RCC_CFGR_PPRE2))
#define CFGR_BUSES_168 (RCC_CFGR_PPRE1(RCC_CFGR_PPRE1_4) | RCC_CFGR_PPRE2(RCC_CFGR_PPRE2_2))
#define PLLCFGR_168                                                                                                    \
    (RCC_PLLCFGR_PLLM(4) | RCC_PLLCFGR_PLLN(168) | RCC_PLLCFGR_PLLP(RCC_PLLCFGR_PLLP_2) | RCC_PLLCFGR_PLLSRC)
#define PLLCFGR_CORE                                                                                                   \
    (FIELD_MASK(RCC_PLLCFGR_PLLM) | FIELD_MASK(RCC_PLLCFGR_PLLN) | FIELD_MASK(RCC_PLLCFGR_PLLP) | RCC_PLLCFGR_PLLSRC)
#define CSR_LSION 1u
#define CSR_LSIRDY 2u
#define CSR_BOR 0x02000000u
#define CSR_PIN 0x04000000u
#define CSR_POR 0x08000000u
#define CSR_SFT 0x10000000u
#define PWR_DBP 0x100u

#define LATENCY_168 5u /* wait states at 2.7 to 3.6 V */
#define HSE_CLOCKS 336000u /* 2 ms */
#define PLL_CLOCKS 16800u /* 100 us */
#define LSI_CLOCKS 6720u /* 40 us */

static bool ready(const rcc_t *rcc, uint64_t clock) { return clock <= rcc->soc->bus.now; }

uint32_t rcc_read(void *peripheral, uint32_t offset)
{
    rcc_t *rcc = (rcc_t *)peripheral;
    switch (offset) {
    case RCC_CR:
        return rcc->cr | ((rcc->cr & RCC_CR_HSION) != 0 ? RCC_CR_HSIRDY : 0u) |
               (ready(rcc, rcc->hse_clock) ? RCC_CR_HSERDY : 0u) | (ready(rcc, rcc->pll_clock) ? RCC_CR_PLLRDY : 0u);
    case RCC_PLLCFGR:
        return rcc->pllcfgr;
    case RCC_CFGR:
        return rcc->cfgr | (rcc->cfgr & FIELD_MASK(RCC_CFGR_SW)) << 2;
    case RCC_CIR:
    case AHB1RSTR:
    case APB1RSTR:
    case APB2RSTR:
        return 0;
    case RCC_AHB1ENR:
        return rcc->soc->enabled[SOC_AHB1];
    case RCC_APB1ENR:
        return rcc->soc->enabled[SOC_APB1];
    case RCC_APB2ENR:
        return rcc->soc->enabled[SOC_APB2];
    case RCC_CSR:
        return rcc->csr | (ready(rcc, rcc->lsi_clock) ? CSR_LSIRDY : 0u);
    default:
        soc_no_register(rcc->soc, NAME, offset);
    }
}

static void check_system_clock(rcc_t *rcc, uint32_t cfgr)
{
    soc_t *soc = rcc->soc;
    if ((cfgr & FIELD_MASK(RCC_CFGR_SW)) != RCC_CFGR_SW_PLL) {
        soc->clocked = false;
        return;
    }
    if (!ready(rcc, rcc->pll_clock)) {
        soc_no_value(soc, NAME, RCC_CFGR, cfgr, "the PLL is not ready");
    }
    if ((rcc->pllcfgr & PLLCFGR_CORE) != PLLCFGR_168 || (cfgr & CFGR_BUSES) != CFGR_BUSES_168) {
        soc_no_value(soc, NAME, RCC_CFGR, cfgr,
                     "only 168 MHz with buses of 42 and 84 MHz from a crystal of 8 MHz is modelled");
    }
    if (rcc->flash_latency < LATENCY_168) {
        soc_no_value(soc, NAME, RCC_CFGR, cfgr, "the flash needs 5 wait states at 168 MHz");
    }
    if ((rcc->pwr_cr & PWR_CR_VOS) == 0) {
        soc_no_value(soc, NAME, RCC_CFGR, cfgr, "168 MHz needs voltage scale 1");
    }
    soc->clocked = true;
}

static void write_cr(rcc_t *rcc, uint32_t value)
{
    const uint64_t now = rcc->soc->bus.now;
    const uint32_t rising = value & ~rcc->cr;
    soc_allow(rcc->soc, NAME, RCC_CR, value & ~(RCC_CR_HSIRDY | RCC_CR_HSERDY | RCC_CR_PLLRDY | 0xFF00u), CR_WRITABLE,
              "bypass and PLLI2S are not modelled");
    if ((value & RCC_CR_HSEON) == 0) {
        rcc->hse_clock = CHIP_NEVER;
    } else if ((rising & RCC_CR_HSEON) != 0) {
        rcc->hse_clock = now + HSE_CLOCKS;
    }
    if ((value & RCC_CR_PLLON) == 0) {
        rcc->pll_clock = CHIP_NEVER;
    } else if ((rising & RCC_CR_PLLON) != 0) {
        if (!ready(rcc, rcc->hse_clock)) {
            soc_no_value(rcc->soc, NAME, RCC_CR, value, "the PLL starts before the crystal is ready");
        }
        rcc->pll_clock = now + PLL_CLOCKS;
    }
    rcc->cr = value & CR_WRITABLE;
}

void rcc_write(void *peripheral, uint32_t offset, uint32_t value)
{
    rcc_t *rcc = (rcc_t *)peripheral;
    soc_t *soc = rcc->soc;
    switch (offset) {
    case RCC_CR:
        write_cr(rcc, value);
        break;
    case RCC_PLLCFGR:
        if ((rcc->cr & RCC_CR_PLLON) != 0) {
            soc_no_value(soc, NAME, offset, value, "written while the PLL is on");
        }
        rcc->pllcfgr = value;
        break;
    case RCC_CFGR:
        soc_allow(soc, NAME, offset, value & ~0xCu, FIELD_MASK(RCC_CFGR_SW) | CFGR_BUSES,
                  "clock outputs and the RTC are not modelled");
        check_system_clock(rcc, value);
        rcc->cfgr = value & (FIELD_MASK(RCC_CFGR_SW) | CFGR_BUSES);
        break;
    case RCC_CIR:
    case AHB1RSTR:
    case APB1RSTR:
    case APB2RSTR:
        soc_allow(soc, NAME, offset, value, (offset == RCC_CIR) ? RCC_CIR_CSSC : 0u,
                  "interrupts and resets of peripherals are not modelled");
        break;
    case RCC_AHB1ENR:
        soc->enabled[SOC_AHB1] = value;
        break;
    case RCC_APB1ENR:
        soc->enabled[SOC_APB1] = value;
        break;
    case RCC_APB2ENR:
        soc->enabled[SOC_APB2] = value;
        break;
    case RCC_CSR:
        if ((value & RCC_CSR_RMVF) != 0) {
            rcc->csr = 0;
        }
        if ((value & CSR_LSION) == 0) {
            rcc->lsi_clock = CHIP_NEVER;
        } else if ((rcc->csr & CSR_LSION) == 0) {
            rcc->lsi_clock = soc->bus.now + LSI_CLOCKS;
        }
        rcc->csr = (rcc->csr & ~CSR_LSION) | (value & CSR_LSION);
        break;
    default:
        soc_no_register(soc, NAME, offset);
    }
}

uint32_t rcc_pwr_read(void *peripheral, uint32_t offset)
{
    rcc_t *rcc = (rcc_t *)peripheral;
    soc_check_gate(rcc->soc, PWR_NAME, SOC_APB1, 28u);
    switch (offset) {
    case PWR_CR:
        return rcc->pwr_cr;
    case PWR_CSR:
        return ready(rcc, rcc->pll_clock) ? PWR_CR_VOS : 0u; /* VOSRDY: the regulator follows the PLL */
    default:
        soc_no_register(rcc->soc, PWR_NAME, offset);
    }
}

void rcc_pwr_write(void *peripheral, uint32_t offset, uint32_t value)
{
    rcc_t *rcc = (rcc_t *)peripheral;
    soc_check_gate(rcc->soc, PWR_NAME, SOC_APB1, 28u);
    if (offset != PWR_CR) {
        soc_no_register(rcc->soc, PWR_NAME, offset);
    }
    soc_allow(rcc->soc, PWR_NAME, offset, value, PWR_CR_VOS | PWR_DBP, "low-power modes and the PVD are not modelled");
    rcc->pwr_cr = value;
}

void rcc_reset(void *peripheral, soc_reset_t cause)
{
    rcc_t *rcc = (rcc_t *)peripheral;
    const uint32_t causes = (cause == SOC_RESET_POWER_ON)   ? CSR_BOR | CSR_PIN | CSR_POR
                            : (cause == SOC_RESET_WATCHDOG) ? CSR_PIN | RCC_CSR_WDGRSTF
                                                            : CSR_PIN | CSR_SFT;
    rcc->csr = (cause == SOC_RESET_POWER_ON) ? causes : (rcc->csr & ~CSR_LSION) | causes;
    rcc->cr = 0x81u;
    rcc->pllcfgr = 0x24003010u;
    rcc->cfgr = 0;
    rcc->pwr_cr = PWR_CR_VOS;
    rcc->flash_latency = 0;
    rcc->hse_clock = rcc->pll_clock = rcc->lsi_clock = CHIP_NEVER;
    rcc->soc->clocked = false;
    rcc->soc->enabled[SOC_AHB1] = 0x00100000u;
    rcc->soc->enabled[SOC_APB1] = rcc->soc->enabled[SOC_APB2] = 0;
}

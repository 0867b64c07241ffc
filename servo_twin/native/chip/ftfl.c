#include "chip/ftfl.h"

#define NS_PER_CLOCK (1000000000u / CHIP_BUS_HZ)

/* Its registers are bytes, two in a word: the even one is the low half. */
enum { STAT_CNFG, SEC_OPT, FCCOB3_2, FCCOB1_0, FCCOB7_6, FCCOB5_4, FCCOBB_A, FCCOB9_8, FPROT3_2, FPROT1_0 };

#define STAT_CCIF 0x80u
#define STAT_RDCOLERR 0x40u
#define STAT_ACCERR 0x20u
#define STAT_FPVIOL 0x10u
#define STAT_MGSTAT0 0x01u
#define STAT_ERRORS (STAT_RDCOLERR | STAT_ACCERR | STAT_FPVIOL)
#define CNFG_RAMRDY 0x0200u
#define UNPROTECTED 0xFFFFu
#define SEC_OPEN 0xFFFEu

#define COMMAND_PROGRAM 0x06u
#define COMMAND_ERASE 0x09u
#define ADDRESS_DATA 0x800000u

static uint64_t now_ns(const ftfl_t *ftfl) { return ftfl->bus->now * NS_PER_CLOCK; }

static bool busy(ftfl_t *ftfl) { return flash_busy(&ftfl->flash, now_ns(ftfl)); }

static uint16_t status(ftfl_t *ftfl)
{
    const unsigned done = busy(ftfl) ? 0u : STAT_CCIF;
    const unsigned failed = (done != 0u && ftfl->flash.failed) ? STAT_MGSTAT0 : 0u;
    return (uint16_t)(done | ftfl->errors | failed);
}

uint16_t ftfl_read(void *peripheral, uint32_t address)
{
    ftfl_t *ftfl = (ftfl_t *)peripheral;
    const unsigned reg = address - FTFL_BASE;
    switch (reg) {
    case STAT_CNFG:
        return (uint16_t)(CNFG_RAMRDY | status(ftfl));
    case SEC_OPT:
        return SEC_OPEN;
    default:
        return (reg < FPROT3_2) ? ftfl->fccob[reg - FCCOB3_2] : UNPROTECTED;
    }
}

/* Other commands, and commands on the program flash, which would stop the software, count as errors of the software. */
static void launch(ftfl_t *ftfl)
{
    const unsigned command = ftfl->fccob[FCCOB1_0 - FCCOB3_2] >> 8;
    const uint32_t address = (ftfl->fccob[FCCOB1_0 - FCCOB3_2] & 0xFFu) << 16 | ftfl->fccob[0];
    const uint32_t value = (uint32_t)ftfl->fccob[FCCOB5_4 - FCCOB3_2] << 16 | ftfl->fccob[FCCOB7_6 - FCCOB3_2];
    const uint32_t byte = address - ADDRESS_DATA;
    if (command != COMMAND_PROGRAM && command != COMMAND_ERASE) {
        bus_fail(ftfl->bus, "FTFL command %02Xh is not modelled", command);
    }
    if (address < ADDRESS_DATA) {
        bus_fail(ftfl->bus, "FTFL command %02Xh on the program flash", command);
    }
    if (byte % 4u != 0u || byte / 4u >= FLASH_WORDS) {
        ftfl->errors |= STAT_ACCERR;
    } else if (command == COMMAND_ERASE) {
        flash_erase(&ftfl->flash, byte / (4u * FLASH_DATA_SECTOR_WORDS), now_ns(ftfl));
    } else {
        flash_program(&ftfl->flash, byte / 4u, value, now_ns(ftfl));
    }
}

void ftfl_write(void *peripheral, uint32_t address, uint16_t value)
{
    ftfl_t *ftfl = (ftfl_t *)peripheral;
    const unsigned reg = address - FTFL_BASE;
    const bool under_way = busy(ftfl);
    if (reg == STAT_CNFG) {
        bus_allow(ftfl->bus, address, value, STAT_CCIF | STAT_ERRORS,
                  "interrupts and suspended erases are not modelled");
        if (!under_way) {
            ftfl->errors = (uint16_t)(ftfl->errors & ~value);
            if ((value & STAT_CCIF) != 0u && (ftfl->errors & (STAT_ACCERR | STAT_FPVIOL)) == 0u) {
                ftfl->flash.failed = false;
                launch(ftfl);
            }
        }
    } else if (reg >= FCCOB3_2 && reg < FPROT3_2) {
        if (!under_way) {
            ftfl->fccob[reg - FCCOB3_2] = value;
        }
    } else {
        bus_no_value(ftfl->bus, address, value, "protection is not modelled");
    }
}

/* Words of 16 bits, the low half of a word of 32 first. */
uint16_t ftfl_data_read(void *peripheral, uint32_t address)
{
    ftfl_t *ftfl = (ftfl_t *)peripheral;
    if (busy(ftfl)) {
        ftfl->errors |= STAT_RDCOLERR;
        return 0u; /* undefined */
    }
    const uint32_t index = address - FTFL_DATA_BASE;
    return (uint16_t)(ftfl->flash.word[index / 2u] >> (16u * (index % 2u)));
}

void ftfl_data_write(void *peripheral, uint32_t address, uint16_t value)
{
    (void)value;
    bus_no_register(((ftfl_t *)peripheral)->bus, address);
}

void ftfl_reset(void *peripheral)
{
    ftfl_t *ftfl = (ftfl_t *)peripheral;
    flash_break_off(&ftfl->flash, now_ns(ftfl));
    ftfl->errors = 0;
}

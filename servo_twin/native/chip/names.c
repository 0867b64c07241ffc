#include <stdio.h>

#include "chip/bus.h"

/* Names for error messages only. */

typedef struct {
    uint16_t begin, end;
    const char *block;
    const char *const *names;
} named_t;

static const char *const pwm_sub[] = {
    "CNT",      "INIT",   "CTRL2",     "CTRL",      "04h",       "VAL0",      "FRACVAL1",  "VAL1",
    "FRACVAL2", "VAL2",   "FRACVAL3",  "VAL3",      "FRACVAL4",  "VAL4",      "FRACVAL5",  "VAL5",
    "FRCTRL",   "OCTRL",  "STS",       "INTEN",     "DMAEN",     "TCTRL",     "DISMAP0",   "DISMAP1",
    "DTCNT0",   "DTCNT1", "CAPTCTRLA", "CAPTCOMPA", "CAPTCTRLB", "CAPTCOMPB", "CAPTCTRLX", "CAPTCOMPX"};
static const char *const pwm_module[] = {"OUTEN", "MASK",   "SWCOUT", "DTSRCSEL", "MCTRL", "MCTRL2", "FCTRL0",
                                         "FSTS0", "FFILT0", "FTST0",  "FCTRL1",   "FSTS1", "FFILT1", "FTST1"};
static const char *const timer[] = {"COMP1",  "COMP2",  "CAPT",   "LOAD", "HOLD", "CNTR", "CTRL", "SCTRL",
                                    "CMPLD1", "CMPLD2", "CSCTRL", "FILT", "DMA",  "0Dh",  "0Eh",  "ENBL"};
static const char *const sci[] = {"RATE", "CTRL1", "CTRL2", "STAT", "DATA", "CTRL3"};
static const char *const gpio[] = {"PUR", "DR",   "DDR",    "PER",     "IAR",   "IENR", "IPOLR",
                                   "IPR", "IESR", "PPMODE", "RAWDATA", "DRIVE", "PUS",  "SRE"};
static const char *const occs[] = {"CTRL", "DIVBY", "STAT", "03h", "OSCTL1", "OSCTL2", "CLKCHKR", "CLKCHKT", "PROT"};
static const char *const cop[] = {"CTRL", "TOUT", "CNTR", "INTVAL"};
static const char *const ftfl[] = {"FSTAT",  "FSEC",   "FCCOB3", "FCCOB1", "FCCOB7", "FCCOB5",
                                   "FCCOBB", "FCCOB9", "FPROT3", "FPROT1", "0Ah",    "FEPROT"};
static const char *const intc[] = {"VBA", "FIM0", "FIVAL0", "FIVAH0", "FIM1", "FIVAL1", "FIVAH1"};
static const char *const intc_ctrl[] = {"CTRL"};
static const char *const adc_low[] = {"CTRL1",  "CTRL2", "ZXCTRL1", "ZXCTRL2", "CLIST1",    "CLIST2",    "CLIST3",
                                      "CLIST4", "SDIS",  "STAT",    "RDY",     "LOLIMSTAT", "HILIMSTAT", "ZXSTAT"};
static const char *const adc_high[] = {"PWR", "CAL", "GC1", "GC2", "SCTRL", "PWR2", "CTRL3", "SCHLTEN"};
static const char *const sim[] = {"CTRL",  "RSTAT",  "SCR0",   "SCR1",   "SCR2",   "SCR3",  "MSHID", "LSHID", "PWR",
                                  "09h",   "CLKOUT", "PCR",    "PCE0",   "PCE1",   "PCE2",  "PCE3",  "SD0",   "SD1",
                                  "SD2",   "SD3",    "IOSAHI", "IOSALO", "PROT",   "GPSAL", "GPSBH", "GPSCL", "GPSCH",
                                  "GPSDL", "GPSEL",  "GPSEH",  "GPSFL",  "GPSFH",  "GPSGL", "GPSGH", "IPS0",  "MISC0",
                                  "PSWR0", "PSWR1",  "PSWR2",  "PSWR3",  "PWRMODE"};

static const named_t named[] = {
    {0xE080, 0xE086, "QSCI0", sci},       {0xE090, 0xE096, "QSCI1", sci},    {0xE0A0, 0xE0A6, "QSCI2", sci},
    {0xE2B0, 0xE2B9, "OCCS", occs},       {0xE30D, 0xE314, "INTC", intc},    {0xE31B, 0xE31C, "INTC", intc_ctrl},
    {0xE320, 0xE324, "COP", cop},         {0xE3C0, 0xE3CC, "FTFL", ftfl},    {0xE400, 0xE429, "SIM", sim},
    {0xE500, 0xE50E, "ADC", adc_low},     {0xE54E, 0xE556, "ADC", adc_high}, {0xE6C0, 0xE6CE, "PWMA", pwm_module},
    {0xE7C0, 0xE7CE, "PWMB", pwm_module},
};

typedef struct {
    uint16_t begin, end;
    const char *block;
} series_t;

static const series_t series[] = {
    {0xE300, 0xE30D, "INTC IPR"},  {0xE314, 0xE31B, "INTC IRQP"},  {0xE340, 0xE35E, "XBARA SEL"},
    {0xE360, 0xE368, "XBARB SEL"}, {0xE380, 0xE388, "AOI BFCRT "}, {0xE50E, 0xE51E, "ADC RSLT"},
    {0xE51E, 0xE52E, "ADC LOLIM"}, {0xE52E, 0xE53E, "ADC HILIM"},  {0xE53E, 0xE54E, "ADC OFFST"},
};

void chip_register_name(uint32_t address, char *name, size_t size)
{
    for (size_t i = 0; i < sizeof named / sizeof named[0]; i++) {
        if (address >= named[i].begin && address < named[i].end) {
            (void)snprintf(name, size, "%s %s", named[i].block, named[i].names[address - named[i].begin]);
            return;
        }
    }
    for (size_t i = 0; i < sizeof series / sizeof series[0]; i++) {
        if (address >= series[i].begin && address < series[i].end) {
            (void)snprintf(name, size, "%s%u", series[i].block, (unsigned)(address - series[i].begin));
            return;
        }
    }
    if (address >= 0xE600u && address < 0xE800u && (address & 0xFFu) < 0xC0u && (address & 0xFFu) % 0x30u < 0x20u) {
        (void)snprintf(name, size, "PWM%c SM%u %s", (address < 0xE700u) ? 'A' : 'B',
                       (unsigned)((address & 0xFFu) / 0x30u), pwm_sub[(address & 0xFFu) % 0x30u]);
    } else if (address >= 0xE140u && address < 0xE1C0u) {
        (void)snprintf(name, size, "TMR%c%u %s", (address < 0xE180u) ? 'A' : 'B', (unsigned)((address >> 4) & 3u),
                       timer[address & 0xFu]);
    } else if (address >= 0xE200u && address < 0xE270u && (address & 0xFu) < 0xEu) {
        (void)snprintf(name, size, "GPIO%c %s", (int)('A' + ((address - 0xE200u) >> 4)), gpio[address & 0xFu]);
    } else {
        (void)snprintf(name, size, "register %04lXh", (unsigned long)address);
    }
}

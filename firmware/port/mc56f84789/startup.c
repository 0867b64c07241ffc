/* startup.c - from reset to the background loop. Silicon only. */
#include "port/mc56f84789/startup.h"

#ifndef CHIP_ON_HOST

#include "config/servo_config.h"
#include "port/mc56f84789/access.h"

hal_t startup_hal;
static servo_t servo;

int main(void)
{
    if (port_init(&startup_hal, &servo, &servo_config)) {
        for (;;) {
            servo_background(&servo);
            WAIT_FOR_INTERRUPT();
        }
    }
    for (;;) { /* no clock or no converter: the watchdog resets the board, which tries again */
    }
}

#ifdef __MWERKS__
extern uint16_t _stack_addr[], _bss_words[], _bss_addr[];
extern uint16_t _data_words[], _data_rom_addr[], _data_ram_addr[];
extern uint16_t _fast_words[], _fast_rom_addr[], _fast_ram_addr[];

/* clang-format off */
/* R2 words from P:(R3) to X:(R0). */
static asm void copy_words(void)
{
    tsta.l  R2
    beq     copied
copy_word:
    move.w  P:(R3)+, X0
    nop
    move.w  X0, X:(R0)+
    dectsta R2
    bne     copy_word
copied:
    rts
}

/* Interrupts off, mode of the core as C requires it, stack, data and fast code out of flash, bss; the symbols are the
 * linker's. */
asm void startup_entry(void)
{
    bfset   #0x0300, SR         /* levels 0 to 2 masked */
    nop
    nop
    bfset   #0x8000, OMR        /* nested hardware loops */
    bfclr   #0x01B0, OMR        /* convergent rounding, XP, R, saturation: off */
    moveu.w #0xFFFF, M01        /* linear addressing */
    moveu.w HWS, LA             /* empty the hardware stack */
    moveu.w HWS, LA
    nop
    nop

    move.l  #>>_stack_addr, R0
    nop
    tfra    R0, SP

    move.l  #>>_data_words, R2
    move.l  #>>_data_rom_addr, R3
    move.l  #>>_data_ram_addr, R0
    jsr     copy_words
    move.l  #>>_fast_words, R2
    move.l  #>>_fast_rom_addr, R3
    move.l  #>>_fast_ram_addr, R0
    jsr     copy_words

    move.l  #>>_bss_words, R2
    tsta.l  R2
    beq     bss_done
    move.l  #>>_bss_addr, R0
    clr.w   X0
clear_word:
    move.w  X0, X:(R0)+
    dectsta R2
    bne     clear_word
bss_done:

    jsr     main
halt:
    bra     halt
}
/* clang-format on */
#endif

#else

typedef int startup_is_for_silicon; /* a translation unit is not empty */

#endif

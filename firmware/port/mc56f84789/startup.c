/* startup.c - from reset to the background loop. Silicon only. */
#include "port/mc56f84789/startup.h"

#ifndef CHIP_ON_HOST

hal_t startup_hal;
static servo_t servo;

int main(void)
{
    if (port_init(&startup_hal, &servo)) {
        for (;;) {
            servo_background(&servo);
        }
    }
    for (;;) { /* no clock or no converter: the watchdog tries again */
    }
}

#ifdef __MWERKS__
extern uint16_t _stack_addr[], _data_words[], _data_rom_addr[], _data_ram_addr[], _bss_words[], _bss_addr[];

/* clang-format off */
/* Interrupts off, mode of the core as C wants it, stack, data out of flash, bss; the symbols are the linker's. */
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
    tsta.l  R2
    beq     data_done
    move.l  #>>_data_rom_addr, R3
    move.l  #>>_data_ram_addr, R0
copy_word:
    move.w  P:(R3)+, X0
    nop
    move.w  X0, X:(R0)+
    dectsta R2
    bne     copy_word
data_done:

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

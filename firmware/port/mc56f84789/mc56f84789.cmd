# mc56f84789.cmd - linker command file of CodeWarrior for the MC56F84789: program in flash, data in RAM.
#
# All addresses and lengths are words. Code and data memory are separate spaces (P and X); the RAM is also seen from P at
# 60000h, where code may run that must not wait for the flash.

MEMORY
{
    .p_vectors      (RX) : ORIGIN = 0x00000, LENGTH = 0x000DE   # 111 vectors of two words
    .p_low          (RX) : ORIGIN = 0x000DE, LENGTH = 0x00122
    .p_flash_config (RX) : ORIGIN = 0x00200, LENGTH = 0x00008   # never let code land here
    .p_flash        (RX) : ORIGIN = 0x00208, LENGTH = 0x1FDF8
    .x_ram          (RW) : ORIGIN = 0x00000, LENGTH = 0x04000
    .x_flex_ram     (RW) : ORIGIN = 0x1E000, LENGTH = 0x00400
    .x_peripherals  (RW) : ORIGIN = 0x0C000, LENGTH = 0x04000
}

KEEP_SECTION { interrupt_vectors.text }

SECTIONS
{
    .vectors :
    {
        * (interrupt_vectors.text)
    } > .p_vectors

    # Key, protection, security (unsecured), options (SIM_PWRMODE in force), data flash.
    .flash_config :
    {
        WRITEH(0xFFFF);
        WRITEH(0xFFFF);
        WRITEH(0xFFFF);
        WRITEH(0xFFFF);
        WRITEH(0xFFFF);
        WRITEH(0xFFFF);
        WRITEH(0x3F7E);
        WRITEH(0xFFFF);
    } > .p_flash_config

    .program :
    {
        * (.text)
        * (rtlib.text)
        * (fp_engine.text)
        * (user.text)
        . = ALIGN(2);
        __data_rom = .;
    } > .p_flash

    # Initialised data and constants lie behind the program and are copied at reset.
    .data_in_flash : AT(__data_rom)
    {
        __data_ram = .;
        * (.const.data.char)
        * (.const.data)
        * (fp_state.data)
        * (rtlib.data)
        * (.data.char)
        * (.data)
        . = ALIGN(2);
        __data_end = .;
    } > .x_ram

    .bss :
    {
        . = ALIGN(2);
        __bss_begin = .;
        * (rtlib.bss.lo)
        * (rtlib.bss)
        * (.bss.char)
        * (.bss)
        . = ALIGN(2);
        __bss_end = .;

        # The stack grows upwards, to the end of the RAM; SP starts odd.
        __stack = . + 1;
    } > .x_ram

    # What startup.c knows of it; C names get the prefix F.
    F_data_rom_addr = __data_rom;
    F_data_ram_addr = __data_ram;
    F_data_words    = __data_end - __data_ram;
    F_bss_addr      = __bss_begin;
    F_bss_words     = __bss_end - __bss_begin;
    F_stack_addr    = __stack;
}

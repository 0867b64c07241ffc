# mc56f84789.cmd - linker command file of CodeWarrior for the MC56F84789: program in flash, fast loops and data in RAM.
#
# All addresses and lengths are words. Code and data memory are separate spaces (P and X). The RAM is seen from both, at
# X:0 and at P:60000h; code that must not wait for the flash runs there:
#
#   X:0      variables with values, constants      copied out of the flash at reset
#            fast_code.text, run-time library      the same; FAST in the makefile says which files these are
#            bss
#            stack, grows upwards to the end
#   X:8000   tables that no interrupt reads        in the data flash (FlexNVM), which is loaded as P:68000h; it is slower
#            flash_table.data                      than the RAM, and within reach of 16-bit pointers
#   X:B800   what the board keeps without power    flash.c: its last four sectors
#
# Where the laid-out parts are too long for the RAM, or the stack has less than __stack_size, the linker says so.

MEMORY
{
    .p_vectors      (RX) : ORIGIN = 0x00000, LENGTH = 0x000DE   # 111 vectors of two words
    .p_low          (RX) : ORIGIN = 0x000DE, LENGTH = 0x00122
    .p_flash_config (RX) : ORIGIN = 0x00200, LENGTH = 0x00008   # never let code land here
    .p_flash        (RX) : ORIGIN = 0x00208, LENGTH = 0x1FDF8
    .x_ram          (RW) : ORIGIN = 0x00000, LENGTH = 0x04000
    .x_image        (RX) : ORIGIN = 0x00000, LENGTH = 0x04000   # the same RAM; X: what is in it is loaded into the flash
    .ram_code       (RX) : ORIGIN = 0x60000, LENGTH = 0x04000   # the same RAM, seen from P
    .x_flex_nvm     (R)  : ORIGIN = 0x08000, LENGTH = 0x03800
    .x_kept         (RW) : ORIGIN = 0x0B800, LENGTH = 0x00800
    .x_flex_ram     (RW) : ORIGIN = 0x1E000, LENGTH = 0x00400
    .x_peripherals  (RW) : ORIGIN = 0x0C000, LENGTH = 0x04000
}

KEEP_SECTION { interrupt_vectors.text }
KEEP_SECTION { fast_code.text }

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
        * (fp_engine.text)
        * (user.text)
        * (.const.data.char.pmem)           # tables that interrupts read (math/program_table.h)
        * (.const.data.pmem)
        . = ALIGN(2);
        __image = .;
    } > .p_flash

    .tables : AT(0x68000)
    {
        * (flash_table.data)
    } > .x_flex_nvm

    # Initialised data and constants lie behind the program and are copied at reset.
    .data_in_flash : AT(__image)
    {
        __data_ram = .;
        WRITEH(0x0BAD);                     # no variable has the address 0
        * (.const.data.char)
        * (.const.data)
        * (fp_state.data)
        * (rtlib.data)
        * (.data.char)
        * (.data)
        . = ALIGN(2);
        __data_words = . - __data_ram;
        __fast_image = __image + __data_words;
    } > .x_image

    # Code behind the data in RAM. Its image begins with a gap as long as the data: that much flash is lost.
    .fast_code : AT(__fast_image)
    {
        . = . + __data_words;
        __fast_begin = .;
        * (fast_code.text)
        * (rtlib.text)                      # products and quotients of 64 bits
        . = ALIGN(2);
        __fast_words = . - __fast_begin;
    } > .ram_code

    .bss :
    {
        . = __data_ram + __data_words + __fast_words;
        __bss_begin = .;
        * (rtlib.bss.lo)
        * (rtlib.bss)
        * (.bss.char)
        * (.bss)
        . = ALIGN(2);
        __bss_end = .;

        # SP starts odd. `make chip-budget` and a test compare what is kept with what background and handlers need.
        __stack_size = 0x0460;
        __stack = . + 1;
        . = . + __stack_size;
    } > .x_ram

    # What startup.c knows of it; C names get the prefix F.
    F_data_rom_addr = __image;
    F_data_ram_addr = __data_ram;
    F_data_words    = __data_words;
    F_fast_rom_addr = __fast_image + __data_words;
    F_fast_ram_addr = __data_ram + __data_words;
    F_fast_words    = __fast_words;
    F_bss_addr      = __bss_begin;
    F_bss_words     = __bss_end - __bss_begin;
    F_stack_addr    = __stack;
}

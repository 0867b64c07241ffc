/* registers.h - what machine.c and simulator.c agree on: addresses of data memory. */
#ifndef REGISTERS_H
#define REGISTERS_H

/* GPIOR0..2 of the ATmega2560: address of a byte of the image; the last one reads as that byte. */
#define IMAGE_LOW 0x3E
#define IMAGE_MIDDLE 0x4A
#define IMAGE_HIGH 0x4B

/* Address and data register of the EEPROM: what is written is printed, or ends the program with an exit status. */
#define CONSOLE 0x40
#define STOP 0x41

#endif

/* simulator.c - runs on the host: `simulator PROGRAM.elf IMAGE` executes a program for machine.h in simavr.
 *
 * The processor is an ATmega2560 with more RAM than it has: 60 KB, as the 56800EX has 32 K words. The image is not
 * part of the program: three general-purpose registers hold an address, and the third one reads as the byte there. The
 * registers of the EEPROM, which is not used, serve as console and exit.
 */
#include <simavr/sim_avr.h>
#include <simavr/sim_core.h>
#include <simavr/sim_elf.h>
#include <stdio.h>
#include <stdlib.h>

#include "registers.h"

#define MCU "atmega2560"

typedef struct {
    uint8_t *bytes;
    long size;
} image_t;

static image_t read_image(const char *path)
{
    image_t image = {NULL, 0};
    FILE *file = fopen(path, "rb");
    if (file == NULL || fseek(file, 0, SEEK_END) != 0 || (image.size = ftell(file)) < 0) {
        perror(path);
        exit(2);
    }
    rewind(file);
    image.bytes = malloc((size_t)image.size + 1U);
    if (image.bytes == NULL || fread(image.bytes, 1, (size_t)image.size, file) != (size_t)image.size) {
        perror(path);
        exit(2);
    }
    (void)fclose(file);
    return image;
}

static uint8_t image_byte(struct avr_t *avr, avr_io_addr_t addr, void *param)
{
    (void)addr;
    const image_t *image = param;
    const long at = avr->data[IMAGE_LOW] | avr->data[IMAGE_MIDDLE] << 8 | (long)avr->data[IMAGE_HIGH] << 16;
    return (at < image->size) ? image->bytes[at] : 0;
}

static void print(struct avr_t *avr, avr_io_addr_t addr, uint8_t value, void *param)
{
    (void)avr;
    (void)addr;
    (void)param;
    (void)putchar(value);
}

static void stop(struct avr_t *avr, avr_io_addr_t addr, uint8_t value, void *param)
{
    (void)addr;
    *(int *)param = value;
    avr->state = cpu_Done;
}

int main(int count, char **words)
{
    elf_firmware_t program = {0};
    if (count != 3 || elf_read_firmware(words[1], &program) != 0) {
        (void)fprintf(stderr, "simulator: PROGRAM.elf IMAGE\n");
        return 2;
    }
    image_t image = read_image(words[2]);
    avr_t *avr = avr_make_mcu_by_name(MCU);
    if (avr == NULL) {
        (void)fprintf(stderr, "simulator: simavr does not support " MCU "\n");
        return 2;
    }
    avr->ramend = MACHINE_RAM_END;
    (void)avr_init(avr);
    avr->log = LOG_ERROR;
    avr_load_firmware(avr, &program);

    int status = 1;
    avr_register_io_write(avr, CONSOLE, print, NULL);
    avr_register_io_write(avr, STOP, stop, &status);
    avr_register_io_read(avr, IMAGE_HIGH, image_byte, &image);

    /* The core only: no timer, no interrupt, no peripheral. avr_run_one goes on for so many cycles before it returns. */
    while (avr->state == cpu_Running) {
        avr->run_cycle_count = 1000000;
        avr->pc = avr_run_one(avr);
    }
    free(image.bytes);
    return status;
}

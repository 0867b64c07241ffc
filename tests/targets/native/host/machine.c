#include "machine.h"

#include <stdio.h>
#include <stdlib.h>

#define IMAGE_SIZE (32u << 20)

static uint8_t image[IMAGE_SIZE];
static size_t image_size;

void machine_start(void) { image_size = fread(image, 1, sizeof image, stdin); }

uint8_t machine_image(uint32_t at) { return (at < image_size) ? image[at] : 0; }

void machine_print(const char *text) { fputs(text, stdout); }

void machine_stop(int status)
{
    fflush(stdout);
    exit(status);
}

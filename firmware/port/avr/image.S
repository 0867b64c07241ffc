; The file MACHINE_IMAGE behind the program, in flash.
    .section .text.zzz_image, "a", @progbits
    .global machine_image_begin
machine_image_begin:
    .incbin MACHINE_IMAGE
    .balign 2

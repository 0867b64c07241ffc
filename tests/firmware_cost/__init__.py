"""What the firmware costs on a Cortex-M3: exact instructions per interrupt and loop, bytes of code and memory.

`programs` compiles the firmware and links it with the programs of ``tests/bench/native``; `instructions` counts while
two axes move, `stages` tells which part of the firmware the instructions belong to, `sizes` reads the linker's map.
`table` puts it all into one table. Nothing here is timed: the same compiler gives the same numbers on every machine.
"""

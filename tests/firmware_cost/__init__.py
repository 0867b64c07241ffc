"""Cost of the firmware on a Cortex-M3: exact instructions per interrupt and loop, bytes of code and memory.

`programs` compiles the firmware and links it with the programs of ``tests/bench/native``; `instructions` counts while
two axes move, `stages` assigns the instructions to source files, `sizes` reads the map of the linker, and `table` makes
one table. Nothing is timed: the same compiler gives the same numbers on every machine.
"""

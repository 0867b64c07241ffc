"""Bit-exact comparison: record the firmware on the virtual board, replay it on other targets, compare.

`recording` runs a scenario on the host and records all calls of ``hal/hal.h``; `machines` builds and runs the replay
program of a target; `comparison` finds the first difference. ``python -m targets`` runs all of it.
"""

"""The same bits on every machine: record the firmware on the virtual board, replay it on other targets, compare.

`recording` runs a scenario on the host and keeps all that crosses ``hal/hal.h``; `machines` builds the replay program
for a target and runs it; `comparison` finds and names the first difference. ``python -m targets`` does all of it.
"""

"""The tuning tool: conversion of nominal values of board and motors to the integers of the controller.

`reading` parses ``servo.toml`` into a `configuration`: `schema` has the range of each number, `checks` the relations
between numbers. `gains` computes gains in SI units from motor data and bandwidths, `constants` converts them to
integers in the `formats` of the firmware (`braking`, `stops`, `temperature`, `winding`, `field_weakening`, `passwords`:
of one group of the file; `sensorless`: observer, PLL and start-up; `optional`: what an axis need not use), `block`
arranges them as a configuration block, and `source` writes them as C. `loops` has the discrete models of the control
loops with one of the `sensors`; `control_loops` computes their gains and `motor` the nominal motor in closed form from
a block; `tuned` refuses unstable loops. `members` reads members of a block in SI units, `board_file` files of all of
them. `assessment` computes figures, `findings` returns warnings, `report` and `picture` show the results. `errors` has
the type of refusals and warnings, `remedies` searches the values of their remedies. `command` is the command line.
"""

"""The tuning tool: conversion of nominal values of board and motors to the integers of the controller.

`reading` parses ``servo.toml`` into a `configuration`: `schema` has the range of each number, `checks` the relations
between numbers. `gains` computes gains in SI units from motor data and bandwidths, `constants` converts them to
integers in the `formats` of the firmware (`braking`, `stops`, `temperature`, `winding`, `field_weakening`, `passwords`:
of one group of the file; `sensorless`: observer, PLL and start-up; `optional`: what an axis need not use), `block`
arranges them as a configuration block, `source` writes them as C, and `restore` computes a file from a block. `loops`
has the discrete models of the control loops with these integers and one of the `sensors`; `tuned` refuses unstable
loops. `assessment` computes figures, `findings` returns warnings, `report` and `picture` show the results. `errors` has
the type of refusals and warnings, `remedies` searches the values of their remedies. `command` is the command line.
"""

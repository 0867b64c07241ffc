"""The tuning tool: from the nominal values of board and motors to the integers that the controller computes with.

`reading` makes a `configuration` of ``servo.toml``: every number by itself as `schema` says, all together as `checks`
say. `gains` follow from motor data and bandwidths in SI units, `constants` are the same as integers in the `formats`
of the firmware, and `source` writes them as C. `loops` are the discrete models of the control loops with those very
integers and one of the `sensors`; `tuned` refuses loops that are unstable, `assessment` computes figures, `findings`
are warnings, `report` and `picture` show all of it. `command` is the command line.
"""

"""Identification of motor, shaft and inverter: refinement by simulation, files, random motors, command line."""

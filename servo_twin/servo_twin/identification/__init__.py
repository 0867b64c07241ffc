"""Motor, shaft and inverter from measurements: refinement by simulation, files, random motors, command line."""

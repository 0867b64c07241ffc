"""Timing of both motors on one chip, simulated from the register values: ``servo-sim timing``."""

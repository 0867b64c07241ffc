"""The timing of both motors on one chip, as it emerges from register values: ``servo-sim timing``."""

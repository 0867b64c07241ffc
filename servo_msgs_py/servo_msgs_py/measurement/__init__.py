"""Measurements on a board: what they need of it, and what they make of the samples."""

"""Measurements on a board: board access, experiments, and evaluation of the samples."""

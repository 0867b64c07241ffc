"""Estimates of the plant from the difference of board and twin, and detection of changes.

Imports neither ROS nor rerun.
"""

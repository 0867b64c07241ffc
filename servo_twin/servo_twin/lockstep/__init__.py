"""Digital twin: executes the commands of the board at the same ticks and compares both boards per sample.

Imports neither ROS nor rerun.
"""

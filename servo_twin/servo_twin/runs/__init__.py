"""Recorded runs: replay through the twin, comparison, export.

They are read with `servo_msgs_py.run_file`, whose libraries are the extra ``record`` of that package.
"""

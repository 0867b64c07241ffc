"""Trajectories of several joints: planning, limits, and timed points for the board.

`waypoints`, `files`, `from_message`: input. `path`: piecewise polynomials, made by `spline` (through waypoints) and
`shapes` (move, stop, sine). `blend`, `merge`: combination of paths. `check`: limits. `timed_points`: points for the
board from a path. `follower`: transmission of the points. `streamer`, `stream`, `playout`, `tracker`: streamed
set-points. `goal`, `tolerances`: goals of the action.
Imports neither ROS nor serial ports.
"""

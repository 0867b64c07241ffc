"""Trajectories of several joints: built, checked, and turned into timed points for the board. Pure: no ROS, no port."""

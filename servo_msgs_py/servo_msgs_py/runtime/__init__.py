"""Run-time support for the programs of bridge and twin: rclpy nodes and child processes.

No other module of servo_msgs_py imports this package.
"""

"""What the programs of bridge and twin share while they run: nodes of rclpy and child processes.

The contract, every other module of servo_msgs_py, never imports this package.
"""

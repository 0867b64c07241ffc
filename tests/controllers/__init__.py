"""Model of ros2_control: hardware interfaces, controllers and their manager, as far as a driver sees them.

Nothing in here uses ROS or a clock: `ControllerManager.cycle` is called with the time and returns the message of this
cycle. The behaviour is that of ros2_control 4.46, ros2_controllers 4.42, joint_state_topic_hardware_interface 1.1 and
topic_based_ros2_control 0.3.
"""

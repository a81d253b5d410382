"""ROS 1 and ROS 2 bags, and what their messages hold."""

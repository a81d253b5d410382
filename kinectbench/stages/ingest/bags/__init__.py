"""ROS 1 and ROS 2 bags, and the content of their messages."""

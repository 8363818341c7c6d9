"""ROS trajectory_msgs/JointTrajectory as JSON: written, and read back."""

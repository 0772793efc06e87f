"""Live samples for other programs: JSON over UDP, Foxglove, ROS 2."""

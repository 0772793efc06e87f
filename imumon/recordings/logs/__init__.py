"""Logs of autopilots and ROS bags, one module each, and how one becomes a session."""

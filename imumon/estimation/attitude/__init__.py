"""Attitude of the body by gyros, accelerometers and, where there is one, the magnetometer."""

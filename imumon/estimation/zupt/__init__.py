"""Gyro bias of a unit at rest, by zero-velocity updates, with and without a thermal model."""

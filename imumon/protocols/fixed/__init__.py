"""Packets of one fixed length, described by a device file alone."""

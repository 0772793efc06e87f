"""Runs of the pipeline: live from a port, again from a recording, once over a file."""

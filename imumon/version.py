"""The version of imumon, which every recording, model and report carries."""

__version__ = "0.2.0"

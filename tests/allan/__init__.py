"""Tests of imumon.allan."""

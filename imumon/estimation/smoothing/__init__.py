"""Estimates of temperature, bias and heading from earlier and later samples; nothing is imported here."""

"""What shakes the unit: the spectra of the last half minute, and their peaks by name."""

"""What several rooms share: slots of samples, turns by gyros, segments, rounding."""

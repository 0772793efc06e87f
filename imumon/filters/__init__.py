"""What several rooms share: slots of samples, turns by gyros, multiple models, rounding, regressions."""

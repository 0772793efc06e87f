"""What several rooms share: slots of samples, turns followed by gyros, multiple models, rounding, regressions."""

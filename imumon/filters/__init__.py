"""What several estimators share: slots of samples, turns followed by gyros, noise models, regressions."""

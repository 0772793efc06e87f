"""From recordings to a bias model: bias over temperature, with its sigma, or a refusal with its reason."""

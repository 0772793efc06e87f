"""From recordings of a unit at rest to the name of what its bias model leaves over."""

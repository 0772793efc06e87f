"""How devices are configured, only when a user asks for it: one file per family over a small core."""

"""Device families: bytes to columns and back."""

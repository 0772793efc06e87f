"""Curves of a bias over temperature, one kind per file: what the model file holds, and how it is fitted."""

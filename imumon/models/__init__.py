"""Bias over temperature: its curves, its model file, and its prediction live."""

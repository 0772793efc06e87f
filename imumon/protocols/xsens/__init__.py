"""Xsens MTi: MTData2 (self-describing) and the legacy MTData (described by a profile)."""

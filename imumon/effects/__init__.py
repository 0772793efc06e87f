"""Physical effects that a bias over temperature leaves out; `kinds` lists them.

Every effect is used three ways: a simulator adds it, the diagnosis regresses on its columns, and a live
bias model carries it along sample by sample.  See `imumon.effects.base` for what they share.
"""

"""A rack: many units on one bench, each in a process of its own, one view of them all."""

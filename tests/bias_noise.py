"""The size of Gauss-Markov processes that make flicker."""

from __future__ import annotations

import math

INSTABILITY_PER_DECADE = math.sqrt(math.pi / math.log(10.0))
"""B over the standard deviation per decade of correlation time: the processes, sd² in a
decade, have together the density sd² pi / (2 pi f ln 10), which is to be that of flicker, B² / (2 pi f)."""

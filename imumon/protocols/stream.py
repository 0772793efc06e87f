"""What all that goes through a stream of bytes has in common."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

ByteArray = npt.NDArray[np.uint8]

CHUNK = 1 << 16
"""Bytes that wait at the most until they are searched."""
LONGEST_PACKET = 4096
"""Bytes that a packet may have, so also the most that can be pending."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import psutil
from imumon.heap import trim_heap
pieces = [bytearray(700) for _ in range(100_000)]
pieces = pieces[::100]
held = psutil.Process().memory_info().rss
trim_heap()
print(held - psutil.Process().memory_info().rss)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the GNU C library")
def test_what_is_free_between_pieces_that_are_held_goes_back() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], check=True, capture_output=True, text=True)
    assert int(done.stdout) > 50_000_000

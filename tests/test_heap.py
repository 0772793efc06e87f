from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import ctypes, sys, threading
from imumon.heap import share_heap
if sys.argv[1] == "shared":
    share_heap()
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.malloc.argtypes = [ctypes.c_size_t]
places = []
thread = threading.Thread(target=lambda: places.append(libc.malloc(1000)))
thread.start()
thread.join()
heap = next(line for line in open("/proc/self/maps") if line.rstrip().endswith("[heap]"))
low, high = (int(end, 16) for end in heap.split()[0].split("-"))
print(low <= places[0] < high)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the GNU C library")
@pytest.mark.parametrize(("how", "there"), [("shared", "True"), ("own", "False")])
def test_memory_of_another_thread_is_of_the_one_heap(how: str, there: str) -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT, how], check=True, capture_output=True, text=True)
    assert done.stdout.split() == [there]

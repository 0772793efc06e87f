"""Loaded by the process that the units of a rack are forked from: what is here they have in common.

Nothing that starts a thread may be: it would not be there in a unit, and what it holds would stay locked.
Rerun does, so each unit loads it by itself.  (The thread of pyarrow's jemalloc is one that knows of forks.)
"""

import gc
import signal

import imumon.fleet.rack.unit  # noqa: F401 - what it imports
from imumon.protocols.device import load_device
from imumon.run.live import warm_up
from imumon.run.setup import Setup

for _number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(_number, signal.SIG_IGN)  # the rack ends its units in order, and this process with them
warm_up(load_device("ax1"), Setup())
gc.collect()
gc.freeze()

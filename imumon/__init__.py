"""imumon: watch, record and understand an IMU or AHRS on the bench.

Conventions, valid in every module, file and table
---------------------------------------------------

Flow, one way::

    port -> bytes + arrival time -> wire recorder (the truth)
              '-> framing -> fields -> epochs -> clock -> SampleBlock -> stages in order -> view, tables
                                         '-> side streams -> tables of their own

Live, replay, import and simulation differ only in what stands at the left end.
docs/architecture.md shows each step and which files to touch to add something, docs/columns.md every column.

Time
    Always int64 nanoseconds.  ``device_time_ns`` is the device's own clock, unwrapped, as the device counts
    it (it starts anew in a new ``segment``); ``arrival_time_ns`` is the Unix time at which the last byte of
    the packet was read from the port; ``host_time_ns`` is the device clock mapped to Unix time,
    fitted to the earliest arrivals: the estimate of when a row was measured, never later than its arrival.

Rows
    A row holds what the inertial sensors measured at one instant, whatever packets its fields came in; what
    has a time and rate of its own (a receiver, a filter) is a side stream with rows and a table of its own.

Units
    SI inside: angular rate rad/s, specific force m/s², angle rad, pressure Pa, temperature °C.  Latitude and
    longitude are degrees.  The magnetic field is µT, or arbitrary units where the device has none; the unit
    is in the metadata of every table.  Degrees and °/h appear only where a person reads.

Frames
    Body axes as in the manual of the device, FLU (x forward, y left, z up) or FRD (x forward, y right,
    z down); the device file names it.  Navigation frame east-north-up (ENU).  Accelerometers measure
    specific force: at rest and level, +9.81 m/s² along the axis that points up.

Attitude
    ``q_{w,x,y,z}`` as the device reports it, scalar first, rotating body vectors into the device's reference
    frame; ``roll, pitch, yaw`` in rad as the device reports them.  Heading is clockwise from north.

Missing values
    NaN; an integer column that lacks values is float64 then, a complete one is int64.  A quantity that the
    device never sends has no column.  Within imumon a missing integer is `imumon.blocks.NO_INT`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from .errors import ImumonError, Reason
from .version import __version__

if TYPE_CHECKING:
    from .blocks import SampleBlock
    from .columns import Column
    from .library.live import Live, open
    from .library.reading import read, read_blocks
    from .library.samples import Samples
    from .models.model import load_model
    from .pipeline import Estimator, Pipeline
    from .run.setup import Setup, load_setup

__all__ = [
    "Column",
    "Estimator",
    "ImumonError",
    "Live",
    "Pipeline",
    "Reason",
    "SampleBlock",
    "Samples",
    "Setup",
    "__version__",
    "load_model",
    "load_setup",
    "open",
    "read",
    "read_blocks",
]

_ROOMS = {
    "blocks": ["SampleBlock"],
    "columns": ["Column"],
    "library.live": ["Live", "open"],
    "library.reading": ["read", "read_blocks"],
    "library.samples": ["Samples"],
    "models.model": ["load_model"],
    "pipeline": ["Estimator", "Pipeline"],
    "run.setup": ["Setup", "load_setup"],
}
"""Where names are made: imported when they are used, so that the command line starts at once."""


def __dir__() -> list[str]:
    return list(__all__)


def __getattr__(name: str) -> object:
    for room, names in _ROOMS.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{room}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

"""DataFlash logs of ArduPilot (.BIN), read with pymavlink.

IMU has TimeUS in µs, the number of the sensor I, GyrX to GyrZ in rad/s, AccX to AccZ in m/s², T in °C; MAG
the field in mGauss and BARO the pressure Press in Pa.  Axes are forward-right-down.
"""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from imumon.blocks import IntArray
from imumon.errors import ImumonError, Reason, missing_package
from imumon.recordings.logs.log import (
    GAUSS_TO_TESLA,
    Log,
    Series,
    Wanted,
    beside,
    named,
    nanoseconds,
    pick,
    triple,
)

SCALING = "the units that DataFlash defines for IMU"
HEAD = b"\xa3\x95\x80"
"""Every message begins with A3 95; the first describes the format of a message, which is number 128."""
KEPT = {
    "IMU": ("TimeUS", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ", "T"),
    "MAG": ("TimeUS", "MagX", "MagY", "MagZ"),
    "BARO": ("TimeUS", "Press"),
}
BESIDE = (
    Wanted("MAG.0", ["MagX", "MagY", "MagZ"], triple("mag"), 1e-3 * GAUSS_TO_TESLA),
    Wanted("BARO.0", ["Press"], ["pressure"]),
)


def is_one(_: Path, head: bytes) -> bool:
    """Tell whether a file is such a log."""
    return head.startswith(HEAD)


def read(path: Path, sensor: str | None = None) -> Log:
    """Return a sensor of a log, by its number, IMU.0 the first.

    Raises
    ------
    ImumonError
        BAD_DATA when it has no IMU messages; BAD_CONFIG when not of this sensor.
    """
    found = _messages(path)
    imus = sorted(name for name in found if name.startswith("IMU."))
    name, others = pick(path, imus, sensor)
    imu = found[name]
    gyro = named(imu, ["GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"], [*triple("gyro"), *triple("accel")])
    # A sensor without a thermometer says 0 all the time.
    if np.any(imu["T"] != 0.0):
        gyro |= named(imu, ["T"], ["temperature"])
    return Log(name, others, Series(_time(imu), gyro), beside(found, BESIDE, _time), "FRD", SCALING)


def _messages(path: Path) -> dict[str, dict[str, Any]]:
    """Return the fields of the messages that are kept, by name and number of the sensor."""
    try:
        from pymavlink.DFReader import DFReader_binary
    except ModuleNotFoundError as error:
        raise missing_package("this log", "pymavlink", "autopilot") from error

    class Log(DFReader_binary):  # type: ignore[misc]  # the package has no types
        """A log whose file is closed, also when it cannot be read."""

        def __init__(self) -> None:
            try:
                super().__init__(str(path))
            except BaseException:
                self.close()
                raise

        def close(self) -> None:
            for name in ("filehandle", "data_map"):
                if hasattr(self, name):
                    getattr(self, name).close()

    rows: dict[str, list[list[float]]] = {}
    try:
        with closing(Log()) as log:
            while (message := log.recv_match(type=list(KEPT))) is not None:
                kind = message.get_type()
                values = [getattr(message, field, np.nan) for field in KEPT[kind]]
                rows.setdefault(f"{kind}.{getattr(message, 'I', 0)}", []).append(values)
        return {
            name: dict(zip(KEPT[name.partition(".")[0]], np.array(values, np.float64).T, strict=True))
            for name, values in rows.items()
        }
    except Exception as error:  # pymavlink raises whatever damaged bytes lead to
        raise ImumonError(Reason.BAD_DATA, f"{path}: cannot be read as a DataFlash log: {error}") from error


def _time(fields: dict[str, Any]) -> IntArray:
    return nanoseconds(fields["TimeUS"])

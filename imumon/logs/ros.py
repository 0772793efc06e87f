"""ROS bags, of ROS 1 and 2 (.bag, .mcap, .db3 or a folder), read with rosbags.

`sensor_msgs/Imu` is in rad/s and m/s², in forward-left-up axes (REP 103); the time is that of the header.
The first topic of MagneticField, Temperature and FluidPressure goes with it.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imumon.errors import ImumonError, bad_data, missing_package
from imumon.recordings.map import triple
from imumon.recordings.wire_reader import is_own

from .log import Log, Series, pick

SECOND_NS = 1_000_000_000
SCALING = "the units that sensor_msgs/Imu defines; whether the driver keeps to them is not known"
HEADS = (b"\x89MCAP0\r\n", b"#ROSBAG V", b"SQLite format 3\x00")
"""How an .mcap, a .bag and a .db3 begin."""
IMU = "sensor_msgs/msg/Imu"


def read(path: Path, sensor: str | None = None) -> Log:
    """Return an Imu topic of a bag, the first by name unless it is named; data_raw comes before data.

    Raises BAD_DATA when it has none, or cannot be read; BAD_CONFIG when not this one.
    """
    if path.is_file() and is_own(path):
        raise bad_data(
            f"{path} is a recording of imumon, not a bag",
            "imumon replay reads its session, imumon decode the file alone",
        )
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise missing_package("this log", "rosbags", "ros2") from error
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
            found = {one.topic for one in bag.connections if one.msgtype == IMU and one.msgcount}
            # What a sensor sent comes before what was made of it, such as rates without their bias.
            topics = sorted(found, key=lambda one: (one.removesuffix("_raw"), not one.endswith("_raw")))
            name, others = pick(path, topics, sensor)
            kinds = [[one.topic for one in bag.connections if one.msgtype == kind] for kind in BESIDE]
            (gyro, *beside), undated = _collect(bag, [name, *(min(of) for of in kinds if of)])
    except ImumonError:
        raise
    except Exception as error:  # each format of a bag has errors of its own
        raise bad_data(
            f"{path}: cannot be read as a ROS bag: {str(error) or type(error).__name__}",
            "if it was cut or damaged, mend it first: mcap recover, ros2 bag reindex or rosbag reindex",
        ) from error
    received = (
        f"{name}: {undated[name]:,} of {len(gyro.time_ns):,} headers have no time: the time at which the"
        " recorder received them stands in, and its jitter and delay are not the sensor's"
    )
    warnings = (received,) if undated[name] else ()
    return Log(name, others, gyro, beside, "FLU", SCALING, warnings=warnings)


def _vector(value: Any) -> list[float]:
    return [value.x, value.y, value.z]


def _imu(message: Any) -> list[float]:
    """Return rate, force and attitude; NaN where the message states that it has none."""
    parts: list[float] = []
    for name in ("angular_velocity", "linear_acceleration", "orientation"):
        value, covariance = getattr(message, name), getattr(message, f"{name}_covariance")
        row = [value.w, *_vector(value)] if name == "orientation" else _vector(value)
        # All zeros are no attitude, whatever the covariance is.
        there = covariance[0] != -1.0 and (name != "orientation" or any(row))
        parts += row if there else [np.nan] * len(row)
    return parts


BESIDE: dict[str, tuple[Callable[[Any], list[float]], Sequence[str]]] = {
    "sensor_msgs/msg/MagneticField": (lambda m: _vector(m.magnetic_field), triple("mag")),
    "sensor_msgs/msg/Temperature": (lambda m: [m.temperature], ["temperature"]),
    "sensor_msgs/msg/FluidPressure": (lambda m: [m.fluid_pressure], ["pressure"]),
}
TAKEN = {IMU: (_imu, [*triple("gyro"), *triple("accel"), "q_w", "q_x", "q_y", "q_z"]), **BESIDE}


def _collect(bag: Any, topics: list[str]) -> tuple[list[Series], Counter[str]]:
    """Return the samples of topics, in their order, those that are there; and of each the undated ones."""
    rows: dict[str, list[list[float]]] = {topic: [] for topic in topics}
    times: dict[str, list[int]] = {topic: [] for topic in rows}
    undated = Counter[str]()
    connections = [one for one in bag.connections if one.topic in rows and one.msgtype in TAKEN]
    kinds = {one.topic: one.msgtype for one in connections}
    for connection, time_ns, raw in bag.messages(connections=connections):
        message = bag.deserialize(raw, connection.msgtype)
        stamp = message.header.stamp
        stamp_ns = stamp.sec * SECOND_NS + stamp.nanosec
        # A driver that leaves the header empty: the time at which it was recorded.
        undated[connection.topic] += stamp_ns == 0
        times[connection.topic].append(stamp_ns or time_ns)
        rows[connection.topic].append(TAKEN[connection.msgtype][0](message))
    found = [
        Series(
            np.array(times[topic], np.int64),
            dict(zip(TAKEN[kinds[topic]][1], np.array(values, np.float64).T, strict=True)),
        )
        for topic, values in rows.items()
        if values
    ]
    return found, undated

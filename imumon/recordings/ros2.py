"""The samples of a run as ROS 2 messages in an MCAP file, for Foxglove, PlotJuggler, rosbag2 and Rerun.

Topics are those of REP 145; body axes are forward-left-up (REP 103), also of a device whose own are
forward-right-down.  Covariances are the squares of the sigmas of the estimators; where there is none they are
zero, which says unknown, and -1 in the first place where there is no quantity, as `sensor_msgs/Imu` has it.

The covariance of the orientation is about the fixed axes east, north and up, rad².  The message has no sign
for an unknown heading beside a known tilt: its variance is then `ANY_HEADING`, as while the heading is free.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.errors import missing_package
from imumon.protocols.base import MAIN
from imumon.recordings.ros2_messages import DEFINITIONS
from imumon.recordings.table import iterate_table, read_columns

Message = dict[str, Any]
CLOCKS = ("host_time_ns", "arrival_time_ns", "device_time_ns")
"""The first that has values is the time of the messages: Unix time, or since power-on in a log without it."""
SECOND_NS = 1_000_000_000
TESLA = {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "nT": 1e-9, "gauss": 1e-4, "mgauss": 1e-7}
UNKNOWN, NOTHING = [0.0] * 9, [-1.0] + [0.0] * 8
ANY_HEADING = np.pi**2 / 3
"""rad²: of a heading that may be any, uniform over the circle."""
OK, WARN = 0, 1
FIX, DIAGONAL_KNOWN = "sensor_msgs/msg/NavSatFix", 2
NOISY = ("gyro", "accel")
DIAGNOSED = (
    *(f"gyro_bias_{axis}" for axis in "xyz"),
    *(f"gyro_bias_sd_{axis}" for axis in "xyz"),
    "at_rest",
    "temperature_rate",
    "heading",
    "heading_sd",
    "model_suspect",
)
"""What stands in the diagnostics, once a second."""


@dataclass(frozen=True, slots=True)
class Written:
    """What became of a run: messages of each topic, the streams they are of, what ROS has no terms for."""

    messages: dict[str, int]
    streams: list[str]
    left_out: list[str]


def write_ros2(tables: Mapping[str, Path], out: Path, axes: Literal["FLU", "FRD"] | None) -> Written:
    """Write tables of a run as one MCAP file.

    Raises BAD_CONFIG when the package mcap-ros2-support is not installed.

    Parameters
    ----------
    tables : mapping of str to Path
        Of the main stream and of each side stream, Parquet.
    axes : "FLU", "FRD" or None
        Body axes of the samples; where they are not known the samples stay as they are.
    """
    try:
        from mcap_ros2.writer import Writer
    except ModuleNotFoundError as error:
        raise missing_package("a ROS 2 bag", "mcap-ros2-support", "ros2") from error
    counts: dict[str, int] = {}
    left_out: list[str] = []
    streams: list[str] = []
    with out.open("wb") as file:
        writer = Writer(file)
        schemas = {name: writer.register_msgdef(name, text) for name, text in DEFINITIONS.items()}
        for stream, path in tables.items():
            published = Stream.of(stream, path, axes)
            left_out += published.left_out
            before = sum(counts.values())
            for block in iterate_table(path):
                for topic, kind, time_ns, message in published.messages(block):
                    number = counts.get(topic, 0)
                    counts[topic] = number + 1
                    writer.write_message(topic, schemas[kind], message, time_ns, sequence=number)
            if sum(counts.values()) > before:
                streams.append(stream)
            elif published.clock:
                left_out.append(f"{stream}: of its columns alone no message can be made")
        writer.finish()  # type: ignore[no-untyped-call]  # the package leaves its return type out
    return Written(counts, streams, left_out)


@dataclass(slots=True)
class Stream:
    """How the samples of a stream become messages, block by block."""

    name: str
    units: Mapping[str, str]
    """Of its columns."""
    clock: str
    """The column that has the times of the messages; empty where there is none."""
    flip: bool
    """Whether the samples are turned by 180° about x, from forward-right-down to forward-left-up."""
    _noise: dict[str, _Noise] = field(default_factory=lambda: {kind: _Noise() for kind in NOISY})
    _published_ns: int | None = None
    """Time of the latest row."""
    _last: dict[str, float] = field(default_factory=dict)
    """The latest reading of what is told when it changes."""

    @classmethod
    def of(cls, name: str, path: Path, axes: Literal["FLU", "FRD"] | None) -> Stream:
        """Return the stream of a table, whose noise is known."""
        units = {column.name: column.unit for column in read_columns(path).values()}
        clocks, made = set[str](), cls(name, units, "", axes == "FRD")
        for block in iterate_table(path):
            clocks |= {one for one in CLOCKS if one in block and (block[one] != NO_INT).any()}
            made.learn(block)
        made.clock = next((one for one in CLOCKS if one in clocks), "")
        return made

    def learn(self, block: SampleBlock) -> None:
        """Take the noise of samples at rest into account, for the covariances."""
        for kind, noise in self._noise.items():
            noise.add(block, kind)

    @property
    def left_out(self) -> list[str]:
        """What has no place in a message."""
        found = [] if self.clock else [f"{self.name}: its rows have no time"]
        if "mag_x" in self.units and self.units["mag_x"] not in TESLA:
            found.append(f"the magnetic field: its unit is {self.units['mag_x']!r}, ROS has tesla")
        return found

    def messages(self, block: SampleBlock) -> Iterator[tuple[str, str, int, Message]]:
        """Yield topic, type, time and message, in the order of the rows."""
        if not self.clock or not len(block):
            return
        times: IntArray = block[self.clock]
        second = times // SECOND_NS
        before = second[0] - 1 if self._published_ns is None else self._published_ns // SECOND_NS
        begins, self._published_ns = np.diff(second, prepend=before) != 0, int(times[-1])
        makers = list(self._makers(block, begins))
        for row in np.flatnonzero(times != NO_INT).tolist():
            time_ns = int(times[row])
            header = {
                "stamp": {"sec": time_ns // SECOND_NS, "nanosec": time_ns % SECOND_NS},
                "frame_id": "imu_link",
            }
            for topic, kind, make in makers:
                message = make(row)
                if message is not None:
                    yield topic, kind, time_ns, {"header": header, **message}
            if begins[row] and self.name == MAIN and (status := self._diagnostics(block, row)) is not None:
                yield (
                    "/diagnostics",
                    "diagnostic_msgs/msg/DiagnosticArray",
                    time_ns,
                    {"header": header, **status},
                )

    def _makers(self, block: SampleBlock, begins: BoolArray) -> Iterator[tuple[str, str, Any]]:
        """Yield topic, type, and what makes the message of a row, for what the block has."""
        if self.name == MAIN:
            yield from self._inertial(block)
        prefix = "" if self.name == MAIN else f"/{self.name}"
        for name in block.columns:
            of = name.removesuffix("latitude")
            if name.endswith("latitude") and f"{of}longitude" in block:
                yield (
                    f"{prefix}/fix" if of in ("", f"{self.name}_") else f"{prefix}/{of}fix",
                    FIX,
                    _fix(block, of),
                )
        if "pressure" in block:
            make = self._scalar(block, begins, "pressure", "fluid_pressure")
            yield f"{prefix}/imu/pressure", "sensor_msgs/msg/FluidPressure", make
        for name in block.columns:
            if name == "temperature" or (name[:-1] == "temperature_" and name[-1] in "xyz"):
                yield (
                    f"{prefix}/imu/{name}",
                    "sensor_msgs/msg/Temperature",
                    self._scalar(block, begins, name, "temperature"),
                )
        if "temperature_estimate" in block:
            make = self._scalar(
                block, begins, "temperature_estimate", "temperature", "temperature_estimate_sd"
            )
            yield f"{prefix}/imu/temperature_estimate", "sensor_msgs/msg/Temperature", make

    def _inertial(self, block: SampleBlock) -> Iterator[tuple[str, str, Any]]:
        gyro, accel = self._vector(block, "gyro"), self._vector(block, "accel")
        of_gyro, of_accel = (np.tile(self._noise[kind].variance, (len(block), 1)) for kind in NOISY)
        if gyro is not None or accel is not None:
            raw = _Imu(gyro, of_gyro, accel, of_accel)
            yield "/imu/data_raw", "sensor_msgs/msg/Imu", raw.message
        bias, sd = self._vector(block, "gyro_bias"), _together(block, "gyro_bias_sd")
        if gyro is not None and bias is not None and sd is not None:
            rates = np.where(of_gyro.all(), sd**2 + of_gyro, 0.0)
            estimated = _Imu(gyro - bias, rates, accel, of_accel, *self._attitude(block))
            yield "/imu/data", "sensor_msgs/msg/Imu", estimated.message
        mag = self._vector(block, "mag")
        if mag is not None and (scale := TESLA.get(self.units["mag_x"])):
            yield "/imu/mag", "sensor_msgs/msg/MagneticField", _field(mag * scale)

    def _scalar(self, block: SampleBlock, begins: BoolArray, column: str, field: str, sd: str = "") -> Any:
        """Return what makes a message of one value and its variance, zero where it is not known.

        A reading is told when it has changed, and once a second; an estimate once a second.
        """
        values = block[column]
        variance: ColumnArray = block[sd] ** 2 if sd in block else np.zeros(len(block))
        due = begins.copy()
        if not sd:
            due |= np.diff(values, prepend=self._last.get(column, np.nan)) != 0
            self._last[column] = float(values[-1])
        due &= np.isfinite(values)

        def make(row: int) -> Message | None:
            if not due[row]:
                return None
            return {field: float(values[row]), "variance": float(np.nan_to_num(variance[row]))}

        return make

    def _vector(self, block: SampleBlock, name: str) -> FloatArray | None:
        """Return a vector in forward-left-up axes, (n, 3)."""
        values = _together(block, name)
        return values if values is None or not self.flip else values * [1.0, -1.0, -1.0]

    def _attitude(self, block: SampleBlock) -> tuple[FloatArray | None, FloatArray | None]:
        """Return the estimated attitude x, y, z, w, body to east-north-up, and variances about these."""
        names = [f"attitude_estimate_{axis}" for axis in "xyzw"]
        if any(name not in block for name in names):
            return None, None
        x, y, z, w = (block[name] for name in names)
        # From forward-left-up to forward-right-down, then as estimated: the product with i.
        q = np.column_stack([w, z, -y, -x] if self.flip else [x, y, z, w])
        missing = np.full(len(block), np.nan)
        tilt, heading, north = (
            block.columns.get(f"attitude_estimate_{name}", missing)
            for name in ("tilt_sd", "heading_sd", "north")
        )
        yaw = np.where((north == 1) & np.isfinite(heading), heading**2, ANY_HEADING)
        return q, np.column_stack([tilt**2, tilt**2, yaw])

    def _diagnostics(self, block: SampleBlock, row: int) -> Message | None:
        values = {name: float(block[name][row]) for name in DIAGNOSED if name in block}
        if not values:
            return None
        suspect = values.get("model_suspect", 0.0) == 1.0
        pairs = [{"key": name, "value": f"{value:.9g}"} for name, value in values.items()]
        status = {
            "level": WARN if suspect else OK,
            "name": "imumon",
            "message": "the bias model is suspect" if suspect else "",
            "hardware_id": "",
            "values": pairs,
        }
        return {"status": [status]}


class _Noise:
    """Variance of the white noise of a sample: half that of successive differences at rest."""

    def __init__(self) -> None:
        self._squares, self._count = np.zeros(3), 0

    def add(self, block: SampleBlock, kind: str) -> None:
        """Take the samples of a sensor, where rest is known."""
        values = _together(block, kind)
        if values is None or "at_rest" not in block:
            return
        at_rest = block["at_rest"] == 1
        steps = np.diff(values, axis=0)[at_rest[1:] & at_rest[:-1]]
        steps = steps[np.isfinite(steps).all(axis=1)]
        self._squares += np.sum(steps**2, axis=0)
        self._count += len(steps)

    @property
    def variance(self) -> FloatArray:
        """Of x, y, z, (3,); zero where it is not known."""
        return np.asarray(self._squares / (2.0 * self._count)) if self._count else np.zeros(3)


def _together(block: SampleBlock, name: str) -> FloatArray | None:
    """Return the columns of a vector, (n, 3), or None."""
    names = [f"{name}_{axis}" for axis in "xyz"]
    return np.column_stack([block[one] for one in names]) if all(one in block for one in names) else None


@dataclass(frozen=True, slots=True)
class _Imu:
    """What a `sensor_msgs/Imu` is made of: values and variances (n, 3), the attitude (n, 4), in SI units."""

    gyro: FloatArray | None
    rates: FloatArray
    accel: FloatArray | None
    forces: FloatArray
    attitude: FloatArray | None = None
    spread: FloatArray | None = None

    def message(self, row: int) -> Message | None:
        """Return the message of a row, or None where it has neither rate nor force."""
        if not _is_there(self.gyro, row) and not _is_there(self.accel, row):
            return None
        return {
            **_part("orientation", self.attitude, self.spread, row, (0.0, 0.0, 0.0, 1.0)),
            **_part("angular_velocity", self.gyro, self.rates, row),
            **_part("linear_acceleration", self.accel, self.forces, row),
        }


def _is_there(values: FloatArray | None, row: int) -> bool:
    return values is not None and bool(np.isfinite(values[row]).all())


def _part(
    name: str,
    values: FloatArray | None,
    variances: FloatArray | None,
    row: int,
    absent: tuple[float, ...] = (0.0, 0.0, 0.0),
) -> Message:
    """Return a vector and its covariance, which says when there is none."""
    if values is None or variances is None or not _is_there(values, row):
        return {name: _named(absent), f"{name}_covariance": NOTHING}
    return {name: _named(values[row]), f"{name}_covariance": _diagonal(variances[row])}


def _field(mag: FloatArray) -> Any:
    def make(row: int) -> Message | None:
        if not np.isfinite(mag[row]).all():
            return None
        return {"magnetic_field": _named(mag[row]), "magnetic_field_covariance": UNKNOWN}

    return make


def _fix(block: SampleBlock, of: str) -> Any:
    """Return what makes a `sensor_msgs/NavSatFix` of a row, with the accuracies that the receiver gives."""
    missing = np.full(len(block), np.nan)
    latitude, longitude = block[f"{of}latitude"], block[f"{of}longitude"]
    altitude = block.columns.get(f"{of}altitude", missing)
    level, upright = (
        block.columns.get(f"{of}{name}_accuracy", missing) for name in ("horizontal", "vertical")
    )

    def make(row: int) -> Message | None:
        if not np.isfinite(latitude[row] + longitude[row]):
            return None
        known = bool(np.isfinite(level[row] + upright[row]))
        spread = np.array([level[row], level[row], upright[row]]) ** 2
        return {
            "status": {"status": 0, "service": 1},
            "latitude": float(latitude[row]),
            "longitude": float(longitude[row]),
            "altitude": float(altitude[row]),
            "position_covariance": _diagonal(spread),
            "position_covariance_type": DIAGONAL_KNOWN if known else 0,
        }

    return make


def _named(values: Any) -> dict[str, float]:
    return dict(zip("xyzw", map(float, values), strict=False))


def _diagonal(variances: FloatArray) -> list[float]:
    x, y, z = map(float, variances)
    return [x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, z] if np.isfinite(x + y + z) else UNKNOWN

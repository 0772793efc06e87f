"""The samples of a run as ROS 2 messages in an MCAP file, for Foxglove, PlotJuggler, rosbag2 and Rerun.

Topics are those of REP 145; body axes are forward-left-up (REP 103), also of a device whose own are
forward-right-down.  Covariances are the squares of the sigmas of the estimators; where there is none they are
zero, which means unknown, and -1 in the first place where there is no quantity, as `sensor_msgs/Imu` has it.

The covariance of the orientation is about the fixed axes east, north and up, rad².  The message has no sign
for an unknown heading beside a known tilt: its variance is then `ANY_HEADING`, as while the heading is free.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from imumon.blocks import NO_INT, BoolArray, FloatArray, IntArray, SampleBlock
from imumon.columns import BodyAxes
from imumon.errors import bad_data, missing_package
from imumon.protocols.base import MAIN

from .map import triple
from .table import CLOCKS, iterate_table, read_columns

Message = dict[str, Any]
SECOND_NS = 1_000_000_000
UNTIL_S = 2**31
"""Of a message of ROS, whose seconds have 32 bits."""
TESLA = {"T": 1.0, "mT": 1e-3, "uT": 1e-6, "nT": 1e-9, "gauss": 1e-4, "mgauss": 1e-7}
UNKNOWN, NOTHING = [0.0] * 9, [-1.0] + [0.0] * 8
ANY_HEADING = np.pi**2 / 3
"""rad²: of a heading that may be any, uniform over the circle."""
OK, WARN = 0, 1
IMU, FIX, MAG = "sensor_msgs/msg/Imu", "sensor_msgs/msg/NavSatFix", "sensor_msgs/msg/MagneticField"
TEMPERATURE, PRESSURE = "sensor_msgs/msg/Temperature", "sensor_msgs/msg/FluidPressure"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
SCALARS = {"pressure": (PRESSURE, "fluid_pressure")} | {
    f"temperature{of}": (TEMPERATURE, "temperature") for of in ("", "_x", "_y", "_z", "_estimate")
}
"""Of columns that become messages of one value: type, and field."""
DIAGONAL_KNOWN = 2
NOISY = ("gyro", "accel")
DIAGNOSED = (
    *triple("gyro_bias"),
    *triple("gyro_bias_sd"),
    "at_rest",
    "temperature_rate",
    "heading",
    "heading_sd",
    "model_suspect",
)
"""What stands in the diagnostics, once a second."""


def write_ros2(tables: Mapping[str, Path], out: Path, axes: BodyAxes | None) -> tuple[list[str], list[str]]:
    """Write tables of a run as one MCAP file; return the streams that it has, and what ROS has no terms for.

    Raises BAD_CONFIG when a package that it needs is not installed; BAD_DATA for times that ROS cannot hold.

    `tables`: of the main stream and of each side stream, Parquet.
    `axes`: body axes of the samples; where they are not known the samples stay as they are.
    """
    try:
        from mcap_ros2.writer import Writer
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise missing_package("a ROS 2 bag", "mcap-ros2-support and rosbags", "ros2") from error
    streams, left_out, counts = list[str](), list[str](), Counter[str]()
    known = get_typestore(Stores.ROS2_FOXY)
    with out.open("wb") as file:
        writer = Writer(file)
        schemas = {
            kind: writer.register_msgdef(kind, known.generate_msgdef(kind, ros_version=2)[0])
            for kind in (IMU, MAG, TEMPERATURE, PRESSURE, FIX, DIAGNOSTICS)
        }
        for stream, path in tables.items():
            published = Stream.of(stream, path, axes)
            if not published.clock:
                left_out.append(f"{stream}: its rows have no time")
            if (unit := published.units.get("mag_x", "T")) not in TESLA:
                left_out.append(f"the magnetic field: its unit is {unit!r}, ROS has tesla")
            before = counts.total()
            for block in iterate_table(path):
                for topic, kind, time_ns, message in published.messages(block):
                    writer.write_message(topic, schemas[kind], message, time_ns, sequence=counts[topic])
                    counts[topic] += 1
            if counts.total() > before:
                streams.append(stream)
            elif published.clock:
                left_out.append(f"{stream}: of its columns alone no message can be made")
        writer.finish()  # type: ignore[no-untyped-call]  # the package leaves its return type out
    return streams, left_out


_Topic = tuple[str, str, BoolArray, Callable[[int], Message]]
"""Messages of a block: topic, type, which rows have one, (n,), and what makes that of a row."""


@dataclass
class Stream:
    """How the samples of a stream become messages, block by block."""

    name: str
    units: Mapping[str, str]  # of its columns
    clock: str  # the column that has the times of the messages; empty where there is none
    flip: bool  # whether the samples are turned by 180° about x, from forward-right-down to forward-left-up
    # Of successive samples at rest, the sum of the squared differences, and how many.
    _squares: dict[str, FloatArray] = field(default_factory=lambda: {name: np.zeros(3) for name in NOISY})
    _steps: dict[str, int] = field(default_factory=lambda: dict.fromkeys(NOISY, 0))
    _second: int | None = None  # in which the latest row was
    _last: dict[str, float] = field(default_factory=dict)  # of what is published when it changes

    @classmethod
    def of(cls, name: str, path: Path, axes: BodyAxes | None) -> "Stream":
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
        for name in NOISY if "at_rest" in block else ():
            at_rest = block["at_rest"] == 1
            steps = np.diff(block.stacked(triple(name)), axis=0)[at_rest[1:] & at_rest[:-1]]
            steps = steps[np.isfinite(steps).all(axis=1)]
            self._squares[name] += np.sum(steps**2, axis=0)
            self._steps[name] += len(steps)

    def messages(self, block: SampleBlock) -> Iterator[tuple[str, str, int, Message]]:
        """Yield topic, type, time and message, in the order of the rows."""
        if not self.clock or not len(block):
            return
        times: IntArray = block[self.clock]
        second = times // SECOND_NS
        known = times[times != NO_INT] * 1e-9
        if not 0.0 <= known.min(initial=0.0) <= known.max(initial=0.0) < UNTIL_S:
            what = f"{self.clock} is from {known.min():.3f} s to {known.max():.3f} s"
            raise bad_data(f"{what}, and ROS 2 has 1970 to 2038", "write .parquet, .csv, .npz or .mat")
        before = second[0] - 1 if self._second is None else self._second
        begins, self._second = np.diff(second, prepend=before) != 0, int(second[-1])
        topics = list(self._topics(block, begins))
        for row in np.flatnonzero(times != NO_INT).tolist():
            sec, nanosec = divmod(int(times[row]), SECOND_NS)
            header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": "imu_link"}
            for topic, kind, due, make in topics:
                if due[row]:
                    yield topic, kind, int(times[row]), {"header": header, **make(row)}

    def _topics(self, block: SampleBlock, begins: BoolArray) -> Iterator[_Topic]:
        """Yield what the block has messages of; `begins` marks the rows that are the first of a second."""
        prefix = ""
        if self.name == MAIN:
            yield from self._inertial(block)
            if any(name in block for name in DIAGNOSED):
                yield "/diagnostics", DIAGNOSTICS, begins, lambda row: _diagnostics(block, row)
        else:
            prefix = f"/{self.name}"
        for name in block.columns:
            of = name.removesuffix("latitude")
            if name.endswith("latitude") and f"{of}longitude" in block:
                topic = f"{prefix}/fix" if of in ("", f"{self.name}_") else f"{prefix}/{of}fix"
                yield _fix(topic, block, of)
        for column in SCALARS:
            if column in block:
                yield self._scalar(f"{prefix}/imu/{column}", block, column, begins)

    def _inertial(self, block: SampleBlock) -> Iterator[_Topic]:
        gyro, accel, mag, bias = (self._vector(block, name) for name in (*NOISY, "mag", "gyro_bias"))
        noise = {
            name: np.tile(self._squares[name] / (2.0 * max(self._steps[name], 1)), (len(block), 1))
            for name in NOISY
        }
        force, none = (accel, noise["accel"]), np.full((len(block), 4), np.nan)
        yield _imu("/imu/data_raw", (none, none), (gyro, noise["gyro"]), force)
        if "gyro_bias_x" in block:
            variances = block.stacked(triple("gyro_bias_sd")) ** 2 + noise["gyro"]
            variances = np.where(self._squares["gyro"].all(), variances, 0.0)
            yield _imu("/imu/data", self._attitude(block), (gyro - bias, variances), force)
        if scale := TESLA.get(self.units.get("mag_x", "")):
            values, there = mag * scale, np.asarray(np.isfinite(mag).all(axis=1))
            unknown = {"magnetic_field_covariance": UNKNOWN}
            yield "/imu/mag", MAG, there, lambda row: {"magnetic_field": _named(values[row]), **unknown}

    def _scalar(self, topic: str, block: SampleBlock, column: str, begins: BoolArray) -> _Topic:
        """Return messages of one value and its variance, zero where it is not known.

        A reading is published when it has changed, and once a second; an estimate once a second.
        """
        (kind, of), values, due = SCALARS[column], block[column], begins.copy()
        variance = np.nan_to_num(block.stacked([f"{column}_sd"])[:, 0] ** 2)
        if column != "temperature_estimate":
            due |= np.diff(values, prepend=self._last.get(column, np.nan)) != 0
            self._last[column] = float(values[-1])

        def make(row: int) -> Message:
            return {of: float(values[row]), "variance": float(variance[row])}

        return topic, kind, due & np.isfinite(values), make

    def _vector(self, block: SampleBlock, name: str) -> FloatArray:
        """Return a vector in forward-left-up axes, (n, 3); NaN where there is none."""
        return block.stacked(triple(name)) * ([1.0, -1.0, -1.0] if self.flip else 1.0)

    def _attitude(self, block: SampleBlock) -> "_Part":
        """Return the estimated attitude x, y, z, w, body to east-north-up, and variances about these."""
        q = block.stacked([f"attitude_estimate_{axis}" for axis in "xyzw"])
        if self.flip:  # from forward-left-up to forward-right-down, then as estimated: the product with i
            x, y, z, w = q.T
            q = np.column_stack([w, z, -y, -x])
        further = [f"attitude_estimate_{name}" for name in ("tilt_sd", "heading_sd", "north")]
        tilt, heading, north = block.stacked(further).T
        yaw = np.where((north == 1) & np.isfinite(heading), heading**2, ANY_HEADING)
        return q, np.column_stack([tilt**2, tilt**2, yaw])


_Part = tuple[FloatArray, FloatArray]
"""A quantity of a message, SI units: values (n, 3) or (n, 4), NaN where there is none; variances (n, 3)."""


def _imu(topic: str, attitude: _Part, rate: _Part, force: _Part) -> _Topic:
    """Return messages `sensor_msgs/Imu` of the rows that have a rate or a force."""
    parts = {"orientation": attitude, "angular_velocity": rate, "linear_acceleration": force}
    inertial = [np.isfinite(values).all(axis=1) for values, _ in (rate, force)]

    def make(row: int) -> Message:
        message: Message = {}
        for name, (values, variances) in parts.items():
            value: Any = (0.0, 0.0, 0.0, 1.0) if name == "orientation" else (0.0, 0.0, 0.0)
            covariance = NOTHING
            if np.isfinite(values[row]).all():
                value, covariance = values[row], _diagonal(variances[row])
            message |= {name: _named(value), f"{name}_covariance": covariance}
        return message

    return topic, IMU, np.any(inertial, axis=0), make


def _fix(topic: str, block: SampleBlock, of: str) -> _Topic:
    """Return messages `sensor_msgs/NavSatFix`, with the accuracies that the receiver gives."""
    names = ("latitude", "longitude", "altitude")
    place = block.stacked([f"{of}{name}" for name in names])
    accuracy = block.stacked([f"{of}{name}_accuracy" for name in ("horizontal", "horizontal", "vertical")])

    def make(row: int) -> Message:
        spread = accuracy[row] ** 2
        return {
            "status": {"status": 0, "service": 1},
            **dict(zip(names, place[row].tolist(), strict=True)),
            "position_covariance": _diagonal(spread),
            "position_covariance_type": DIAGONAL_KNOWN if np.isfinite(spread).all() else 0,
        }

    return topic, FIX, np.isfinite(place[:, 0] + place[:, 1]), make


def _diagnostics(block: SampleBlock, row: int) -> Message:
    values = {name: float(block[name][row]) for name in DIAGNOSED if name in block}
    suspect = values.get("model_suspect", 0.0) == 1.0
    status = {
        "level": WARN if suspect else OK,
        "name": "imumon",
        "message": "the bias model is suspect" if suspect else "",
        "hardware_id": "",
        "values": [{"key": name, "value": f"{value:.9g}"} for name, value in values.items()],
    }
    return {"status": [status]}


def _named(values: Any) -> dict[str, float]:
    return dict(zip("xyzw", map(float, values), strict=False))


def _diagonal(variances: FloatArray) -> list[float]:
    return np.diag(variances).ravel().tolist() if np.isfinite(variances).all() else UNKNOWN

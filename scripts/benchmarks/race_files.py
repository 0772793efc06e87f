"""What imumon writes, opened by programs that know nothing of it: do the same numbers come out?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.measure import Table
from benchmarks.peers import named
from imumon.blocks import FloatArray
from imumon.library.reading import read
from imumon.pipeline import Pipeline
from imumon.protocols.device import device_text, load_device
from imumon.recordings.side_tables import export_run
from imumon.recordings.source import open_source, run_over
from imumon.simulation.recording import record_session
from imumon.simulation.unit import load_scenario

SECONDS = 60.0
DEVICE = "ax1"
GYRO = ["gyro_x", "gyro_y", "gyro_z"]
EXACT = 1e-15
"""A norm of three numbers is rounded: a bit or two may differ between equal ones."""


@dataclass(frozen=True, slots=True)
class Reader:
    """Another program that opens a file.

    Parameters
    ----------
    package : str
    file : str
        Suffix of an exported file, or the name of one of the session itself.
    rates : callable
        From the path to the angular rates in rad/s, (n, 3).
    """

    package: str
    file: str
    rates: Callable[[Path], Any]


def _pandas(kind: str) -> Callable[[Path], Any]:
    def rates(path: Path) -> Any:
        import pandas

        return getattr(pandas, f"read_{kind}")(path)[GYRO].to_numpy()

    return rates


def _polars(kind: str) -> Callable[[Path], Any]:
    def rates(path: Path) -> Any:
        import polars

        return getattr(polars, f"read_{kind}")(path)[GYRO].to_numpy()

    return rates


def _duckdb(path: Path) -> Any:
    import duckdb

    columns = duckdb.execute(f"select {', '.join(GYRO)} from '{path}'").fetchnumpy()
    return np.column_stack([np.ma.filled(columns[name], np.nan) for name in GYRO])


def _numpy(path: Path) -> Any:
    with np.load(path) as file:
        return np.column_stack([file[name] for name in GYRO])


def _scipy(path: Path) -> Any:
    from scipy.io import loadmat

    file = loadmat(path)
    return np.column_stack([file[name].ravel() for name in GYRO])


def _rosbags(path: Path) -> Any:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    found = []
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_FOXY)) as reader:
        wanted = [one for one in reader.connections if one.topic == "/imu/data_raw"]
        for connection, _, raw in reader.messages(wanted):
            message: Any = reader.deserialize(raw, connection.msgtype)
            rate = message.angular_velocity
            found.append((rate.x, rate.y, rate.z))
    return np.array(found)


def _mcap_ros2(path: Path) -> Any:
    from mcap_ros2.reader import read_ros2_messages

    found = []
    for one in read_ros2_messages(path, topics=["/imu/data_raw"]):
        rate = one.ros_msg.angular_velocity
        found.append((rate.x, rate.y, rate.z))
    return np.array(found)


def _mcap(path: Path) -> Any:
    """Return the rates in the bytes that the reader finds, which imumon's decoder has to take from them."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        wire = b"".join(message.data for *_, message in make_reader(file).iter_messages(topics=["/wire"]))
    decoder = load_device(DEVICE).decoder()
    decoder.feed(wire, 1)
    decoder.finish()
    rows = decoder.take()
    return np.column_stack([rows[name] for name in GYRO])


READERS = (
    Reader("pandas", "csv", _pandas("csv")),
    Reader("polars", "csv", _polars("csv")),
    Reader("duckdb", "csv", _duckdb),
    Reader("pandas", "parquet", _pandas("parquet")),
    Reader("polars", "parquet", _polars("parquet")),
    Reader("duckdb", "parquet", _duckdb),
    Reader("numpy", "npz", _numpy),
    Reader("scipy", "mat", _scipy),
    Reader("rosbags", "mcap", _rosbags),
    Reader("mcap-ros2-support", "mcap", _mcap_ros2),
    Reader("mcap", "wire.mcap", _mcap),
)


def _files(folder: Path, seconds: float, kinds: set[str]) -> tuple[dict[str, Path], FloatArray]:
    """Record a session and export it; return the files by kind, and the rates as imumon reads them."""
    scenario = load_scenario("bench").model_copy(update={"duration_s": seconds})
    session = folder / "session"
    record_session(scenario, load_device(DEVICE), device_text(DEVICE)[0], 1, session, lambda _: None)
    files = {"wire.mcap": session / "wire.mcap"}
    for suffix in kinds - files.keys():
        source, path = open_source(session), folder / f"run.{suffix}"
        pipeline = Pipeline(source.device)
        export_run(run_over(source.items, pipeline), pipeline, source, path, None)
        files[suffix] = path
    rows = read(session, estimates=False)
    return files, np.column_stack([rows[name] for name in GYRO])


def outcome(reader: Reader, path: Path, true: FloatArray) -> tuple[list[str], bool]:
    """Return how many rows the reader found, how far they are from the truth, and whether that is all well.

    The lengths of the vectors are compared, as ROS has axes of its own.
    """
    try:
        rates = np.asarray(reader.rates(path), np.float64)
    except Exception as error:  # noqa: BLE001 - whatever keeps the other from opening it is the result
        return [f"no: {type(error).__name__}: {error}"[:80], "-"], False
    if rates.shape != true.shape:
        return [f"{len(rates)} of {len(true)}", "-"], False
    norms, expected = np.linalg.norm(rates, axis=1), np.linalg.norm(true, axis=1)
    apart = float(np.abs(norms - expected).max() / expected.max())
    return [f"{len(rates)}", f"{apart:.0e}"], apart <= EXACT


def table(seconds: float = SECONDS, readers: Sequence[Reader] = READERS) -> Table:
    """Open everything with everything that is installed."""
    result = Table("Files opened by others", ["other", "file", "rows", "difference", "opened"])
    opened = offered = 0
    with TemporaryDirectory() as folder:
        files, true = _files(Path(folder), seconds, {reader.file for reader in readers})
        for reader in readers:
            name = named(reader.package)
            if name is None:
                result.rows.append([reader.package, reader.file, "not installed", "-", "-"])
                continue
            found, good = outcome(reader, files[reader.file], true)
            offered, opened = offered + 1, opened + good
            result.rows.append([name, reader.file, *found, "yes" if good else "**no**"])
    result.notes.append(
        f"**{opened} of {offered} opened with the same numbers.** A session of {seconds:g} s at 100 Hz, "
        "exported to each format; `wire.mcap` is the session's own file, whose bytes the reader hands to "
        "imumon's decoder. npz, mat, Parquet in pandas, and mcap in mcap-ros2-support are read by the "
        "library that imumon wrote them with, the rest by programs with readers of their own."
    )
    return result

"""A log becomes a session, through the table and the map that are made of it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from imumon.errors import bad_config, bad_data
from imumon.files import readable
from imumon.recordings.importing import ImportReport, import_table

from . import ardupilot, betaflight, px4, ros
from .log import Log

Reader = Callable[[Path, str | None], Log]


def import_log(path: Path, sensor: str | None, out: Path) -> tuple[ImportReport, Log]:
    """Make a session of one inertial sensor of a log; return what became of its rows, and the log.

    Rows whose time does not increase are counted only.

    Raises ImumonError as `reader_of`, the reader of the log, and `imumon.recordings.importing.import_table`.
    """
    log = reader_of(path)(path, sensor)
    with TemporaryDirectory(prefix="imumon-log-") as folder:
        table = Path(folder) / "log.parquet"
        dropped = log.write(table)
        if dropped == len(log.gyro.time_ns):
            raise bad_data(
                f"{path}: none of the {dropped:,} samples of {log.sensor} has a time",
                "make a table of it (mavlogdump.py --format csv), and give --map MAP.yaml",
            )
        files = [one for one in path.iterdir() if one.is_file()] if path.is_dir() else [path]
        largest = max(files, key=lambda one: one.stat().st_size)  # whose fingerprint is kept, of a bag
        rows = import_table(table, table.with_suffix(".yaml"), out, largest, dropped)
    return replace(rows, warnings=(*log.warnings, *rows.warnings)), log


def reader_of(path: Path) -> Reader:
    """Return what reads a log, chosen by its content, not its name.

    Raises BAD_DATA when it cannot be read; BAD_CONFIG when it is none of these logs, and needs a map.
    """
    head = b""
    if not path.is_dir():
        with readable(path), path.open("rb") as file:
            head = file.read(64)
        if not head:
            raise bad_data(f"{path}: is empty")
    if head.startswith(ardupilot.HEAD):
        return ardupilot.read
    if head.startswith(px4.HEAD):
        return px4.read
    if head.startswith(ros.HEADS) or (path / "metadata.yaml").is_file():
        return ros.read
    if head.startswith(betaflight.BEGIN) or betaflight.TABLE.match(head):
        return betaflight.read
    raise bad_config(
        f"{path}: is no log of ArduPilot (.BIN), PX4 (.ulg) or Betaflight (blackbox_decode), and no ROS bag",
        "a table needs --map MAP.yaml, which names what is in which column",
    )

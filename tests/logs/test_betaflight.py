"""Tables of blackbox_decode become sessions, with a scale that the log itself says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imumon.errors import ImumonError, Reason
from imumon.logs.importing import import_log
from imumon.logs.log import Log
from imumon.recordings.folder import open_session
from imumon.recordings.importing import ImportReport
from imumon.recordings.table import read_table
from tests.cli.command import answer, imumon

HEAD = (
    "H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\n"
    "H Firmware type:Cleanflight\nH Firmware revision:Betaflight 4.5.1 (77d01ba3b) MATEKF405\n"
    "H gyro_scale:0x3f800000\nH acc_1G:2048\n"
)
FINE = "H blackbox_high_resolution:1\n"
ROWS = 200


def table(path: Path, rate: str = "", head: str = "", rows: int = ROWS) -> Path:
    """Write what blackbox_decode does of a quad that rolls at 20 °/s and stands on its feet."""
    of_rate = f" ({rate})" if rate else ""
    gyros = [f"{name}[{k}]{of_rate}" for name in ("gyroADC", "gyroUnfilt") for k in range(3)]
    forces = [f"accSmooth[{k}]" for k in range(3)]
    flags = ["flightModeFlags (flags)", "failsafePhase (flags)"]
    lines = [", ".join(["loopIteration", "time (us)", "axisP[0]", *gyros, *forces, *flags])]
    for k in range(rows):
        numbers: list[int | str] = [k, 1_000_000 + 500 * k, 3, 20, -10, 0, 21, -11, 1, 1, 2, 2048]
        numbers += ["ANGLE_MODE|ARM", "IDLE"]
        lines.append(", ".join(f"{number:>3}" for number in numbers))
    path.write_text(head + "\n".join(lines) + "\n")
    return path


def imported(path: Path, out: Path, sensor: str | None = None) -> tuple[ImportReport, Log, dict[str, float]]:
    report, log = import_log(path, sensor, out)
    block, _ = read_table(open_session(out).truth_path)
    return report, log, {name: float(np.nanmean(values)) for name, values in block.columns.items()}


def test_raw_numbers_with_the_log_beside(tmp_path: Path) -> None:
    other = HEAD.replace("0x3f800000", "0x40000000").replace("2048", "4096")
    (tmp_path / "LOG7.BFL").write_bytes(other.encode() + b"I\x00\xffH " + HEAD.encode() + b"I\x01\x80")
    report, log, means = imported(table(tmp_path / "LOG7.02.csv"), tmp_path / "s")
    assert log.scaling == "gyro raw x 1 °/s, accelerometer raw / 2048 g, by log 2 of LOG7.BFL"
    assert (log.sensor, log.others) == ("gyroADC", ["gyroUnfilt"])
    assert means["gyro_x"] == pytest.approx(np.radians(20.0))
    assert means["gyro_y"] == pytest.approx(-np.radians(10.0))
    assert means["accel_z"] == pytest.approx(9.80665)
    assert report.rows_out == ROWS
    assert report.rate_hz == pytest.approx(2000.0)
    session = open_session(tmp_path / "s").metadata
    assert session.axes == "FLU"
    assert session.table is not None
    assert log.scaling in session.table.map_yaml
    report, log, means = imported(table(tmp_path / "LOG7.01.csv"), tmp_path / "first", "gyroUnfilt")
    assert log.scaling == "gyro raw x 2 °/s, accelerometer raw / 4096 g, by log 1 of LOG7.BFL"
    assert means["gyro_x"] == pytest.approx(np.radians(42.0))


def test_units_in_the_names_are_refused_with_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(ImumonError, match=r"no gyroADC\[0\] of raw numbers") as error:
        import_log(table(tmp_path / "a.csv", "deg/s", head=HEAD), None, tmp_path / "s")
    assert "without options for units" in error.value.hint


def test_rates_of_high_resolution_are_tenths(tmp_path: Path) -> None:
    _, log, means = imported(table(tmp_path / "a.csv", head=HEAD + FINE), tmp_path / "s")
    assert "/10, as blackbox_high_resolution is on" in log.scaling
    assert means["gyro_x"] == pytest.approx(np.radians(2.0))
    assert means["accel_z"] == pytest.approx(9.80665), "the firmware scales the rates alone"


def test_without_acc_1g_there_is_no_accelerometer(tmp_path: Path) -> None:
    head = HEAD.replace("H acc_1G:2048\n", "")
    _, log, means = imported(table(tmp_path / "a.csv", head=head), tmp_path / "s")
    assert "accelerometer left out, as the log has no acc_1G" in log.scaling
    assert "accel_z" not in means


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ("", "the scale of its gyro is not stated"),
        (HEAD.replace("Cleanflight", "Baseflight"), "the firmware is 'Baseflight'"),
        (HEAD.replace("H Firmware type:Cleanflight\n", ""), "the firmware is 'none'"),
        (HEAD.replace("0x3f800000", "0x00000000"), "its gyro_scale is '0x00000000'"),
        (HEAD.replace("0x3f800000", "one"), "its gyro_scale is 'one'"),
        (HEAD.replace("H gyro_scale:0x3f800000\n", ""), "its gyro_scale is ''"),
    ],
)
def test_what_cannot_be_verified_is_refused_and_nothing_is_made(tmp_path: Path, head: str, said: str) -> None:
    with pytest.raises(ImumonError) as error:
        import_log(table(tmp_path / "a.csv", head=head), None, tmp_path / "s")
    assert said in error.value.seen
    assert error.value.reason is Reason.BAD_CONFIG
    assert "--map" in error.value.hint
    assert not (tmp_path / "s").exists()


def test_a_log_that_does_not_have_so_many_logs_reports_nothing(tmp_path: Path) -> None:
    (tmp_path / "LOG7.bbl").write_text(HEAD)
    with pytest.raises(ImumonError, match="the scale of its gyro is not stated"):
        import_log(table(tmp_path / "LOG7.02.csv"), None, tmp_path / "s")


def test_a_log_that_was_not_decoded_states_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "LOG7.bbl").write_bytes(HEAD.encode() + b"I\x00\x01")
    done = imumon("import", tmp_path / "LOG7.bbl", "--out", tmp_path / "s")
    assert done.returncode == 2
    assert f"blackbox_decode {tmp_path / 'LOG7.bbl'}" in done.stderr


def test_a_damaged_table_is_refused(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", head=HEAD)
    path.write_text(path.read_text().replace(" 20,", " x,", 1))
    with pytest.raises(ImumonError) as error:
        import_log(path, None, tmp_path / "s")
    assert error.value.reason is Reason.BAD_DATA


def test_a_row_that_is_cut_is_left_out_and_counted(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", head=HEAD)
    whole = path.read_text().rstrip("\n")
    row = whole.rsplit("\n", 1)[1]
    path.write_text(f"{whole}\n{row[: row.index('-10')]}")
    report, log = import_log(path, None, tmp_path / "s")
    assert report.rows_out == ROWS
    assert (log.damage.places, log.damage.size) == (1, row.index("-10"))


def test_the_command_states_the_scaling(tmp_path: Path) -> None:
    found = answer("import", table(tmp_path / "a.csv", head=HEAD), "--out", tmp_path / "s")
    assert found["scaling"] == "gyro raw x 1 °/s, accelerometer raw / 2048 g, by the head of a.csv"

"""What a recording must be for an Allan deviation, and what is said of one that is odd."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from imumon.allan.recording import read_channels
from imumon.errors import ImumonError, Reason
from imumon.files import check_outputs

N = 2000


def columns() -> dict[str, Any]:
    rng = np.random.default_rng(0)
    made: dict[str, Any] = {"device_time_ns": np.arange(N) * 10_000_000}
    return made | {f"gyro_{axis}": 1e-3 * rng.normal(size=N) for axis in "xyz"}


def write(folder: Path, made: dict[str, Any]) -> Path:
    pq.write_table(pa.table(made), folder / "t.parquet")
    return folder / "t.parquet"


def refusal(path: Path) -> str:
    with pytest.raises(ImumonError) as caught:
        read_channels(path)
    assert caught.value.reason is Reason.BAD_DATA
    return str(caught.value)


def test_what_is_no_recording_is_refused_with_the_reason(tmp_path: Path) -> None:
    assert "there is no such file" in refusal(tmp_path / "none.parquet")
    (tmp_path / "notes.txt").write_text("hello")
    assert "neither a session nor a table" in refusal(tmp_path / "notes.txt")
    (tmp_path / "t.csv").write_text("")
    assert "cannot be read" in refusal(tmp_path / "t.csv")
    assert "no samples" in refusal(write(tmp_path, {name: part[:0] for name, part in columns().items()}))
    nothing = {f"gyro_{axis}": np.full(N, np.nan) for axis in "xyz"}
    assert "no two numbers" in refusal(write(tmp_path, columns() | nothing))


@pytest.mark.long
@pytest.mark.parametrize("factor", [1e-9, 1e-6, 1e-3])
def test_times_in_another_unit_are_refused(tmp_path: Path, factor: float) -> None:
    made = columns()
    made["device_time_ns"] = made["device_time_ns"] * factor
    said = refusal(write(tmp_path, made))
    assert "nanoseconds" in said or "even rate" in said


def test_a_table_that_states_its_other_unit_is_refused(tmp_path: Path) -> None:
    made = pa.table(columns())
    field = made.schema.field("gyro_x").with_metadata({"unit": "deg/s"})
    pq.write_table(made.cast(made.schema.set(1, field)), tmp_path / "t.parquet")
    assert "deg/s, not in rad/s" in refusal(tmp_path / "t.parquet")


def test_units_that_cannot_be_are_reported(tmp_path: Path) -> None:
    made = still(20.0, 300.0, 1e-3)
    made |= {f"accel_{axis}": made[f"accel_{axis}"] / 9.80665 for axis in "xyz"}
    said = " ".join(read_channels(write(tmp_path, made)).warnings)
    assert (
        "100% of the specific force readings are not within 0.3 to 3 times gravity but 0.1 in the mean"
        in said
    )
    assert "scale and unit right" in said


def test_gravity_in_a_unit_that_turns_over_is_no_wrong_unit(tmp_path: Path) -> None:
    angle = np.linspace(0, 2 * np.pi, N, endpoint=False)
    force = {"accel_x": 9.8 * np.sin(angle), "accel_y": np.zeros(N), "accel_z": 9.8 * np.cos(angle)}
    warnings = read_channels(write(tmp_path, columns() | force)).warnings
    assert not any("specific force" in text for text in warnings)


def test_a_channel_without_numbers_is_left_out_and_reported(tmp_path: Path) -> None:
    opened = read_channels(write(tmp_path, columns() | {"gyro_y": np.full(N, np.nan)}))
    assert list(opened.series) == ["gyro_x", "gyro_z"]
    assert "gyro_y: fewer than two numbers" in " ".join(opened.warnings)


@pytest.mark.parametrize("value", [1e4, 1e10, 1e160, -1e300, np.inf])
def test_what_no_gyro_reads_is_left_out_and_reported(tmp_path: Path, value: float) -> None:
    made = columns()
    made["gyro_y"][N // 2] = value
    opened = read_channels(write(tmp_path, made))
    assert opened.series["gyro_y"].samples == N - 1
    assert np.abs(opened.series["gyro_y"].values).max() < 1.0
    assert "left out of all estimates: gyro_y beyond -1000 to 1000 rad/s (1 in all)" in opened.warnings


def test_gyros_that_say_one_thing_only_leave_the_accelerometers(tmp_path: Path) -> None:
    made = still(100.0, 20.0, 1e-3) | {f"gyro_{axis}": np.full(N, 0.01) for axis in "xyz"}
    opened = read_channels(write(tmp_path, made))
    assert list(opened.series) == ["accel_x", "accel_y", "accel_z"]
    said = " ".join(opened.warnings)
    assert "gyro while its values are nothing but its first reading" in said
    assert "gyro_x, gyro_y, gyro_z: fewer than two numbers; left out" in said


def test_a_csv_with_quoted_names_is_read(tmp_path: Path) -> None:
    made = columns()
    header = ",".join(f'"{name}"' for name in made)
    rows = np.column_stack(list(made.values()))
    np.savetxt(tmp_path / "t.csv", rows, delimiter=",", header=header, comments="", fmt=["%d", *["%.9g"] * 3])
    assert read_channels(tmp_path / "t.csv").series["gyro_x"].samples == N


def test_a_few_seconds_are_not_called_motion(tmp_path: Path) -> None:
    opened = read_channels(write(tmp_path, {name: part[:100] for name, part in columns().items()}))
    warnings = " ".join(opened.warnings)
    assert "moved" not in warnings
    assert "at rest is unknown" in warnings


def test_nothing_is_overwritten_but_a_picture(tmp_path: Path) -> None:
    there = tmp_path / "pipeline.yaml"
    there.write_text("mine")
    with pytest.raises(ImumonError, match="already") as caught:
        check_outputs(None, there)
    assert caught.value.reason is Reason.EXISTS
    with pytest.raises(ImumonError, match=r"ends in .png"):
        check_outputs(there)
    with pytest.raises(ImumonError, match="no folder"):
        check_outputs(None, tmp_path / "none" / "n.yaml")
    (tmp_path / "a.png").touch()
    check_outputs(tmp_path / "a.png", None, tmp_path / "k.yaml")


def test_two_outputs_are_two_files(tmp_path: Path) -> None:
    (tmp_path / "link.yaml").symlink_to(tmp_path / "a.yaml")
    for other in ("a.yaml", "link.yaml"):
        with pytest.raises(ImumonError, match="are the same file"):
            check_outputs(None, tmp_path / "a.yaml", tmp_path / other)


def still(rate_hz: float, seconds: float, noise: float, step: float = 0.0) -> dict[str, Any]:
    """Return the columns of a unit at rest, with noise in SI units per root second."""
    n = int(rate_hz * seconds)
    rng = np.random.default_rng(8)
    made: dict[str, Any] = {"device_time_ns": np.arange(n) * round(1e9 / rate_hz)}
    for sensor in ("gyro", "accel"):
        for axis in "xyz":
            values = noise * np.sqrt(rate_hz) * rng.normal(size=n) + 9.81 * (sensor + axis == "accelz")
            made[f"{sensor}_{axis}"] = step * np.round(values / step) if step else values
    return made


def told_of_rest(path: Path) -> str:
    return " ".join(read_channels(path).warnings)


def test_a_noisy_gyro_at_a_high_rate_does_not_move(tmp_path: Path) -> None:
    said = told_of_rest(write(tmp_path, still(4000.0, 12.0, 1e-3)))
    assert "moved" not in said


def test_nothing_is_reported_of_motion_that_coarse_steps_hide(tmp_path: Path) -> None:
    said = told_of_rest(write(tmp_path, still(100.0, 60.0, 1e-3, step=0.1)))
    assert "the unit moved" not in said
    assert "cannot be distinguished" in said

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imumon.errors import ImumonError, Reason
from imumon.fleet.rack.description import MOST_UNITS, changes, load_rack
from imumon.protocols.device import device_text
from imumon.run.setup import Setup

GOOD = """format: imumon-rack/1
default:
  device: ax1
  baud: 921600
units:
  left: {port: /dev/ttyUSB0, serial: "17"}
  right: {port: /dev/ttyUSB1, device: xsens, baud: 460800, pipeline: bench.yaml}
"""


def written(folder: Path, text: str) -> Path:
    (folder / "bench.yaml").write_text("format: imumon-pipeline/1\nlatitude_deg: 48.0\n")
    path = folder / "rack.yaml"
    path.write_text(text)
    return path


def refused(path: Path) -> str:
    with pytest.raises(ImumonError) as caught:
        load_rack(path)
    assert caught.value.reason is Reason.BAD_CONFIG
    return caught.value.seen


def test_a_unit_has_what_it_states_and_the_rest_from_the_default(tmp_path: Path) -> None:
    plans = load_rack(written(tmp_path, GOOD))
    assert list(plans) == ["left", "right"]
    left, right = plans.values()
    assert (left.settings.url, left.settings.baudrate, left.serial) == ("/dev/ttyUSB0", 921600, "17")
    assert (right.settings.baudrate, right.serial) == (460800, None)
    assert left.device_yaml == device_text("ax1")[0]
    assert left.setup == Setup()
    assert right.setup.latitude_deg == 48.0


def test_a_device_file_is_looked_for_beside_the_rack(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(device_text("ax1")[0].replace("name: ax1", "name: mine"))
    plans = load_rack(written(tmp_path, GOOD.replace("device: ax1", "device: mine.yaml")))
    assert "name: mine" in plans["left"].device_yaml


def test_a_name_that_no_file_can_have_is_refused(tmp_path: Path) -> None:
    assert "left: " in refused(written(tmp_path, GOOD.replace("device: ax1", f"device: {'x' * 300}")))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("baud: 921600", "baud: 0", r":4: default\.baud: .*greater than or equal to 1, got 0"),
        ("baud: 460800", "baud: fast", r":7: units\.right\.baud: .*integer, got 'fast'"),
        ("/dev/ttyUSB1", "/dev/ttyUSB0", r": units\.right\.port: /dev/ttyUSB0 is the port of left already"),
        ("  device: ax1\n", "", r": units\.left\.device: neither the unit nor the default names"),
        ("left:", "../left:", r":6: units\.\.\./left"),
        ("serial:", "colour:", r":6: units\.left\.colour: unknown key"),
        ("imumon-rack/1", "imumon-rack/2", r":1: format: .*imumon-rack/1"),
        ("port: /dev/ttyUSB0, ", "", r":6: units\.left\.port: this key is required"),
        ("device: xsens", "device: sensx", r": right: no device 'sensx'"),
        ("bench.yaml", "none.yaml", r": right: .*none\.yaml: cannot be read"),
        ("/dev/ttyUSB1", '"\\a"', r": right: the name of the port is not plain text"),
    ],
)
def test_what_is_wrong_is_reported_in_one_line_with_its_place(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    path = written(tmp_path, GOOD.replace(old, new, 1))
    seen = refused(path)
    assert re.fullmatch(re.escape(str(path)) + said + ".*", seen), seen


def test_there_are_not_more_units_than_any_bench_has(tmp_path: Path) -> None:
    units = "".join(f"  u{number}: {{port: /dev/tty{number}}}\n" for number in range(MOST_UNITS + 1))
    head = GOOD[: GOOD.index("  left")]
    assert f"at most {MOST_UNITS}" in refused(written(tmp_path, head + units))
    assert "at least 1" in refused(written(tmp_path, head.replace("units:", "units: {}")))


PIECES = st.sampled_from(
    [
        *GOOD.split(),
        ": ",
        "\n",
        "  ",
        "{",
        "}",
        "[",
        "]",
        "&a",
        "*a",
        "- ",
        "1e999",
        ".nan",
        "'",
        '"',
        "\x00",
        "é",
    ]
)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_other_text_is_taken_or_refused_with_its_file(tmp_path: Path, data: st.DataObject) -> None:
    start = data.draw(st.integers(0, len(GOOD)))
    end = data.draw(st.integers(start, min(len(GOOD), start + 40)))
    text = GOOD[:start] + "".join(data.draw(st.lists(PIECES, max_size=5))) + GOOD[end:]
    path = written(tmp_path, text)
    units, said = outcome(path)
    assert units or said.startswith(str(path))


def outcome(path: Path) -> tuple[int, str]:
    """Return how many units a rack has, or why it is refused."""
    try:
        return len(load_rack(path)), ""
    except ImumonError as error:
        return 0, error.seen


def test_a_change_is_reported_once_and_when_it_is_complete(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD)
    changed = changes(path)
    assert not next(changed)
    path.write_text(GOOD + "#")
    assert [next(changed) for _ in range(4)] == [False, True, False, False]
    path.unlink()
    assert [next(changed) for _ in range(3)] == [False, False, False]
    path.write_text(GOOD + "##")
    assert [next(changed) for _ in range(3)] == [False, True, False]

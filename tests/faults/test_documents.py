from __future__ import annotations

import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.config import DEEPEST, LARGEST_NUMBER, StrictModel, parse_yaml
from imumon.errors import ImumonError, Reason
from imumon.files import LARGEST_TEXT, read_text
from imumon.protocols.device import load_device, parse_device
from imumon.run.setup import parse_setup
from imumon.units import EXAMPLES, parse_unit
from tests.faults.documents import DOCUMENTS, LOADERS, attack_all, device_with, refused


class Numbers(StrictModel):
    values: list[float]


def test_hostile_documents_are_refused_by_every_loader(tmp_path: Path) -> None:
    load_device("vectornav")  # with its imports
    assert not [row for row in attack_all(tmp_path) if not row.held]


@pytest.mark.parametrize("name", sorted(LOADERS))
def test_an_unreasonable_number_names_its_line(tmp_path: Path, name: str) -> None:
    path = tmp_path / "x.yaml"
    for kind in ("1e400", "10^19", "not a number", "infinity"):
        path.write_text(DOCUMENTS[kind])
        assert f"{path}:2: " in refused(lambda: LOADERS[name](path))


@pytest.mark.parametrize("scale", [".nan", "1e400", "1/0", "0", "-.inf", "99999999999999999999", '"1/0"'])
def test_a_scale_that_is_no_scale_is_refused(scale: str) -> None:
    text = device_with("scale: ", f"scale: {scale} # ")
    assert "device.yaml:" in refused(lambda: parse_device(text, "device.yaml").decoder())


@pytest.mark.parametrize(
    "unit",
    [
        "10^10^10^10 deg/s",
        "(9)**(9)**(9) deg/s",
        "s^(9**9)",
        "1e99999999 rad/s",
        "deg/s/" + "9" * 5000,
        "rad/s/0",
        " /" * 100_000,
    ],
)
def test_a_unit_that_would_be_computed_for_ever_is_refused_at_once(unit: str) -> None:
    began = time.process_time()
    with pytest.raises(ValueError, match=r"usual here|is not a unit"):
        parse_unit(unit, "rad/s")
    assert time.process_time() - began < 0.5


@given(text=st.text(alphabet="0123456789.eE^*/()-+ degrasmgu\N{DEGREE SIGN}", max_size=40))
@settings(max_examples=300, deadline=None)
def test_any_text_is_a_unit_or_refused(text: str) -> None:
    for target in EXAMPLES:
        try:
            parse_unit(text, target)
        except ValueError:
            continue


def test_a_nul_in_a_path_is_a_wrong_path(tmp_path: Path) -> None:
    with pytest.raises(ImumonError, match="null byte"):
        parse_setup('format: imumon-pipeline/1\nmodel: "a\\0b"\n', str(tmp_path / "p.yaml"))
    with pytest.raises(ImumonError, match="null byte"):
        load_device("a\0b.yaml")


def test_a_file_of_100_mb_is_refused_without_being_read(tmp_path: Path) -> None:
    path = tmp_path / "big.yaml"
    with path.open("wb") as file:
        file.truncate(100_000_000)
    began = time.process_time()
    with pytest.raises(ImumonError, match=f"more than {LARGEST_TEXT >> 20} MiB"):
        read_text(path)
    assert time.process_time() - began < 1.0


@given(
    values=st.lists(st.floats() | st.integers(-(10**400), 10**400), max_size=5),
    depth=st.integers(0, 2 * DEEPEST),
)
@settings(max_examples=200, deadline=None)
def test_numbers_are_taken_in_range_and_depth_only(values: list[float], depth: int) -> None:
    shown = [str(value).replace("inf", ".inf").replace("nan", ".nan") for value in values]
    text = f"values: {'[' * depth}[{', '.join(shown)}]{']' * depth}"
    sound = depth == 0 and all(abs(value) < LARGEST_NUMBER for value in values)
    if sound:
        assert parse_yaml(text, Numbers, "x.yaml").values == [float(value) for value in values]
        return
    with pytest.raises(ImumonError, match=r"x\.yaml:1: ") as caught:
        parse_yaml(text, Numbers, "x.yaml")
    assert caught.value.reason is Reason.BAD_CONFIG

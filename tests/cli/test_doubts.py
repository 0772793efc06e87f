"""A device file that does not fit a capture is doubted, and one that fits never."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.intake import SpecificForce
from imumon.pipeline import Pipeline
from imumon.protocols.device import load_device
from imumon.run.account import doubts
from imumon.simulation.unit import SimulatedUnit, load_scenario
from tests.cli.command import answer, device, imumon

UNCHECKED = ("type: fletcher16-256", "type: none")


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A thousand packets of an AX1."""
    packets = load_device("ax1").encoder().encode(SimulatedUnit(load_scenario("bench")).samples(1000))
    path = tmp_path_factory.mktemp("capture") / "ax1.raw"
    path.write_bytes(b"".join(packets))
    return path


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ([("length: 58\n", "length: 60\n")], "48% of the bytes are in no packet: are length"),
        (
            [("byte_order: big", "byte_order: little")],
            "of the specific force readings are not within 0.3 to 3 times gravity",
        ),
        (
            [("accel_z], scale: 1.0e-6, unit: m/s^2", "accel_z], scale: 1.0e-6, unit: g")],
            "100% of the specific force readings are not within 0.3 to 3 times gravity",
        ),
    ],
    ids=["length", "byte order", "unit"],
)
def test_a_device_file_that_does_not_fit_is_doubted(
    capture: Path, changes: list[tuple[str, str]], said: str, tmp_path: Path
) -> None:
    described = device(tmp_path, UNCHECKED, *changes)
    done = imumon("decode", capture, "--device", described, "--out", tmp_path / "t.parquet", "--json")
    assert done.returncode == 0
    doubts = json.loads(done.stdout)["doubts"]
    assert any(said in doubt for doubt in doubts), doubts
    assert all(f"WARN  {doubt}" in done.stderr for doubt in doubts)


def test_floats_with_swapped_bytes_are_doubted() -> None:
    values = np.random.default_rng(0).normal(5.0, 1.0, (3, 200)).astype(np.float32).byteswap()
    with np.errstate(invalid="ignore"):  # some are signalling NaN
        swapped = values.astype(np.float64)
    block = SampleBlock({f"accel_{axis}": each for axis, each in zip("xyz", swapped, strict=True)})
    force = SpecificForce()
    assert [*force.through([block])] == [block]
    (doubt,) = doubts(True, Pipeline(None).counters, force)
    assert "of the specific force readings are not within 0.3 to 3 times gravity" in doubt


def test_a_checksum_that_fits_by_chance_is_doubted(capture: Path, tmp_path: Path) -> None:
    described = device(tmp_path, ("type: fletcher16-256, first: 2, last: 55, at: 56", SUM))
    (doubt,) = answer("decode", capture, "--device", described, "--out", tmp_path / "t.parquet")["doubts"]
    assert "of the bytes are in no packet: are length and checksum" in doubt


SUM = "type: xor8, first: 2, last: 55, at: 56"


@pytest.mark.parametrize("share", [0.0, 0.01, 0.1])
def test_a_device_file_that_fits_is_not_doubted_however_noisy_the_line(
    capture: Path, share: float, tmp_path: Path
) -> None:
    data = np.frombuffer(capture.read_bytes(), np.uint8).reshape(1000, 58).copy()
    random = np.random.default_rng(0)
    struck = random.random(1000) < share
    data[struck, random.integers(0, 58, int(struck.sum()))] ^= 0xFF
    (tmp_path / "noisy.raw").write_bytes(random.bytes(500) + data.tobytes()[:-30])
    for described in (device(tmp_path), device(tmp_path, UNCHECKED)):
        told = answer(
            "decode", tmp_path / "noisy.raw", "--device", described, "--out", tmp_path / "t.parquet"
        )
        assert told["doubts"] == []

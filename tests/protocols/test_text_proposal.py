from __future__ import annotations

import json

import numpy as np
import pytest

from imumon.protocols.device import DeviceFile, parse_device
from imumon.protocols.text_proposal import propose
from tests.protocols.streams import feed_in_chunks

N, RATE = 100, 50.0
RNG = np.random.default_rng(3)
ACCEL = RNG.normal((0.2, -0.1, 9.8), 0.05, (N, 3))
GYRO = RNG.normal((0.3, -0.2, 0.1), 0.1, (N, 3))
MAG = RNG.normal((20, 5, -42), 0.5, (N, 3))
TICKS = (np.arange(N) * 20_000 + 7_000_000).astype(int)


def lines(rows: list[str]) -> bytes:
    return ("torn\n" + "\r\n".join(rows) + "\r\nto").encode()


def device_for(data: bytes) -> tuple[DeviceFile, str]:
    proposal = propose(data, N / RATE, 115_200)
    assert proposal is not None
    return parse_device(proposal, "proposed"), proposal


def checked(data: bytes) -> None:
    """The proposed device must read the stream, specific force and rate in their columns."""
    device, _ = device_for(data)
    block = feed_in_chunks(device.decoder(), data, [50])
    assert len(block) >= N - 1
    n = len(block)
    for k, axis in enumerate("xyz"):
        np.testing.assert_allclose(block[f"accel_{axis}"], ACCEL[:n, k], atol=0.01)
        np.testing.assert_allclose(np.rad2deg(block[f"gyro_{axis}"]), GYRO[:n, k], atol=0.01)


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
@pytest.mark.parametrize("prefix", ["", "#IMU=", "I,"])
def test_numbers_between_separators(separator: str, prefix: str) -> None:
    rows = np.column_stack([TICKS, ACCEL, GYRO, 31.5 + 0 * TICKS])
    text = [prefix + separator.join([f"{int(row[0])}", *(f"{x:.4f}" for x in row[1:])]) for row in rows]
    data = lines(text)
    checked(data)
    block = feed_in_chunks(device_for(data)[0].decoder(), data, [50])
    assert block["device_ticks"][:2].tolist() == TICKS[:2].tolist()
    assert device_for(data)[0].decoder().timing.tick_ns == 1000
    assert block["temperature"][0] == 31.5


def test_counts_of_a_sensor_are_known_by_gravity() -> None:
    counts = np.rint(ACCEL / 9.80665 * 16384).astype(int)
    data = lines([",".join(map(str, row)) for row in np.column_stack([counts, np.rint(MAG).astype(int)])])
    device, text = device_for(data)
    block = feed_in_chunks(device.decoder(), data, [50])
    np.testing.assert_allclose(block["accel_z"], ACCEL[: len(block), 2], atol=0.01)
    assert "gravity is 16384" in text
    assert "mag_x" in text


def test_pairs_and_their_names() -> None:
    names = ("ax", "ay", "az", "gx", "gy", "gz", "temp")
    rows = np.column_stack([ACCEL, GYRO, np.full(N, 25.0)])
    data = lines([",".join(f"{n}:{x:.4f}" for n, x in zip(names, row, strict=True)) for row in rows])
    checked(data)
    assert feed_in_chunks(device_for(data)[0].decoder(), data, [50])["temperature"][0] == 25


def test_json_lines() -> None:
    rows = [{"t": int(t), "acc": list(np.round(a, 4)), "gyro": list(np.round(g, 4)), "temp": 21.0}
            for t, a, g in zip(TICKS, ACCEL, GYRO, strict=True)]  # fmt: skip
    data = lines([json.dumps(row) for row in rows])
    checked(data)
    assert "device_ticks" in device_for(data)[1]


def test_sentences_with_checksum() -> None:
    rows = []
    for a, g in zip(ACCEL, GYRO, strict=True):
        body = "XIMU," + ",".join(f"{x:.4f}" for x in [*a, *g])
        rows.append(f"${body}*{np.bitwise_xor.reduce(np.frombuffer(body.encode(), np.uint8)):02X}")
    data = lines(rows)
    checked(data)
    assert "xor8" in device_for(data)[1]


@pytest.mark.parametrize("data", [b"", b"hello\n" * 50, bytes(range(256)) * 20, b"1,2,3\n" * 10])
def test_nothing_is_proposed_without_enough_lines_of_numbers(data: bytes) -> None:
    assert propose(data, 1.0, None) is None

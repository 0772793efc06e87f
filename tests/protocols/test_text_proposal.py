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


def test_each_name_is_proposed_once() -> None:
    unit = ACCEL / np.linalg.norm(ACCEL, axis=1, keepdims=True)[:, [0, 0, 0]]
    rows = np.column_stack([TICKS, TICKS, ACCEL, GYRO, unit, GYRO[::-1], ACCEL[:, :2] * 0 + 25])
    data = lines([f"{row[0]:.0f},{row[1]:.0f}," + ",".join(f"{x:.4f}" for x in row[2:]) for row in rows])
    checked(data)
    text = device_for(data)[1]
    assert "also looks like accel_x (norm 1 with scatter" in text
    for name in ("value_1", "value_8", "value_9", "value_10", "value_11", "value_12", "value_13", "value_15"):
        assert f"column: {name}}}" in text
    assert text.count("column: device_ticks") == text.count("column: temperature") == 1


def test_keys_that_differ_in_capitals_alone_have_columns_of_their_own() -> None:
    device, _ = device_for(lines([f"foo:{-k % 7},Foo:{-k % 5}" for k in range(N)]))
    assert [c.name for c in device.decoder().columns] == ["arrival_time_ns", "foo_raw", "value_1"]


def test_a_force_that_changed_while_the_unit_moved_is_not_about_zero() -> None:
    turn = np.sin(np.arange(N) / 8)
    force = (1.03 + 0.15 * np.cos(np.arange(N) / 5)) * np.array([GYRO[:, 0] / 10, np.sin(turn), np.cos(turn)])
    data = lines([",".join(f"{x:.4f}" for x in row) for row in np.column_stack([force.T, GYRO])])
    text = device_for(data)[1]
    assert "the unit moved; keep it at rest while detecting" in text.split("column: value_0")[0]
    assert "about zero" not in text.split("column: value_2")[0]
    assert "column: gyro_z" in text.split("at: 5")[1]


def test_a_few_shocks_leave_the_norm_of_a_force_steady() -> None:
    force = ACCEL / 9.80665
    force[[20, 21, 60]] *= [[2.5], [0.3], [1.9]]
    data = lines([",".join(f"{x:.4f}" for x in row) for row in force])
    assert "gravity is 1\n      - {at: 2, column: accel_z, scale: 1, unit: g}" in device_for(data)[1]


def test_a_rate_with_a_large_bias_is_no_rate_about_zero() -> None:
    rates = np.add(GYRO, (2.1, -1.1, 0.3))
    text = device_for(lines([",".join(f"{x:.4f}" for x in row) for row in rates]))[1]
    assert "noise about a bias" in text
    assert "about zero" not in text
    assert "column: gyro_z, unit: deg/s" in text


def test_pairs_and_their_names() -> None:
    names = ("ax", "ay", "az", "gx", "gy", "gz", "temp")
    rows = np.column_stack([ACCEL, GYRO, np.full(N, 25.0)])
    data = lines([",".join(f"{n}:{x:.4f}" for n, x in zip(names, row, strict=True)) for row in rows])
    checked(data)
    assert feed_in_chunks(device_for(data)[0].decoder(), data, [50])["temperature"][0] == 25


@pytest.mark.parametrize("named", [False, True])
def test_a_temperature_may_come_before_the_force(named: bool) -> None:
    names = ("temp", "ax", "ay", "az", "gx", "gy", "gz")
    rows = np.column_stack([np.full(N, 25.0) + RNG.normal(0, 0.01, N), ACCEL, GYRO])
    as_json = [json.dumps(dict(zip(names, np.round(row, 4).tolist(), strict=True))) for row in rows]
    data = lines(as_json if named else [",".join(f"{x:.4f}" for x in row) for row in rows])
    checked(data)
    assert "column: temperature" in device_for(data)[1]


@pytest.mark.parametrize("up", [(9.8, 0.1, 0.2), (0.1, 9.8, 0.2), (0.1, 0.2, -9.8)])
def test_the_axis_that_is_vertical_does_not_matter(up: tuple[float, float, float]) -> None:
    rows = np.column_stack([GYRO, np.add(ACCEL, np.subtract(up, (0.2, -0.1, 9.8)))])
    text = device_for(lines([",".join(f"{x:.4f}" for x in row) for row in rows]))[1]
    for k, name in enumerate([f"{what}_{axis}" for what in ("gyro", "accel") for axis in "xyz"]):
        assert f"at: {k}, column: {name}," in text


@pytest.mark.parametrize("start_ms", [1_700_000_000_123, -50])
def test_a_time_of_the_day_or_before_zero_is_read(start_ms: int) -> None:
    data = lines([f"{start_ms + 20 * k},{x:.4f},{y:.4f},{z:.4f}" for k, (x, y, z) in enumerate(ACCEL)])
    block = feed_in_chunks(device_for(data)[0].decoder(), data, [50])
    assert len(block) >= N - 1
    assert np.diff(block["device_ticks"])[0] == pytest.approx(20e6)


def test_names_need_not_be_ascii() -> None:
    rows = [f'{{"température °C": {25 + k / 1000}, "ax": {x:.4f}}}' for k, x in enumerate(ACCEL[:, 0])]
    data = lines(rows)
    assert len(feed_in_chunks(device_for(data)[0].decoder(), data, [7])) == N


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

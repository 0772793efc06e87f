"""Recordings with readings that cannot be, and the same ones without: what a command makes of them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imumon.blocks import ColumnArray, IntArray, SampleBlock
from imumon.protocols.device import parse_device
from imumon.recordings.folder import PortUsed, SessionMetadata, create_session
from imumon.recordings.wire import WireWriter
from imumon.transport.reader import Bytes, Event, EventKind

Columns = dict[str, ColumnArray]

BEGIN_NS = 1_767_225_600_000_000_000
RANGE_DEG_S, RANGE_G = 100.0, 8.0
SENT = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z", "mag_x", "mag_y", "mag_z")
DEVICE = f"""format: imumon-device/1
name: floats
title: A device that can send any number
protocol: fixed
rate_hz: 10
axes: FLU
range: {{gyro_deg_per_s: {RANGE_DEG_S:g}, accel_g: {RANGE_G:g}}}
packet:
  length: 90
  byte_order: little
  sync: [0xA5, 0x5A]
  checksum: {{type: crc16-kermit, first: 2, last: 87, at: 88}}
  fields:
    - {{at: 2, type: u16, column: packet_counter}}
    - {{at: 4, type: u32, column: device_ticks, unit: us}}
    - {{at: 8, type: f64, columns: [gyro_x, gyro_y, gyro_z], unit: rad/s}}
    - {{at: 32, type: f64, columns: [accel_x, accel_y, accel_z], unit: m/s^2}}
    - {{at: 56, type: f64, column: temperature, unit: degC}}
    - {{at: 64, type: f64, columns: [mag_x, mag_y, mag_z], unit: uT}}
"""
READ = 50
"""Packets that arrive at once."""


@dataclass(frozen=True, slots=True)
class Fault:
    """What is done to a recording, and which of its packets come twice."""

    strike: Callable[[Columns], None] = lambda _: None
    twice: float = 0.0
    """Share of the packets."""


def write_session(folder: Path, columns: Columns, rate_hz: float, fault: Fault | None = None) -> Path:
    """Make a session of a device that sends these readings; what is not there is NaN."""
    fault = fault or Fault()
    n = len(next(iter(columns.values())))
    time_us = np.rint(np.arange(n) * (1e6 / rate_hz)).astype(np.int64)
    sent: Columns = {name: np.full(n, np.nan) for name in (*SENT, "temperature")}
    sent |= {name: values.copy() for name, values in columns.items() if name in sent}
    fault.strike(sent)
    sent |= {"packet_counter": np.arange(n) % 65536, "device_ticks": time_us % 2**32}
    rows: IntArray = np.arange(n)
    if fault.twice:
        again = np.random.default_rng(3).random(n) < fault.twice
        rows = np.sort(np.concatenate([rows, rows[again]]))
    device = parse_device(DEVICE, "floats.yaml")
    packets = device.encoder().encode(SampleBlock({name: values[rows] for name, values in sent.items()}))
    metadata = SessionMetadata.begun(
        "simulation", BEGIN_NS, device=device.name, axes="FLU", device_yaml=DEVICE,
        port=PortUsed(url="simulation", settings={}), serial="SN1",
    )  # fmt: skip
    session = create_session(folder, metadata)
    with closing(WireWriter(session.wire_path, {"device": device.name})) as writer:
        writer.write(Event(EventKind.OPENED, BEGIN_NS, "made"))
        for at in range(0, len(packets), READ):
            part = packets[at : at + READ]
            arrived = BEGIN_NS + int(time_us[rows[at + len(part) - 1]]) * 1000 + 1_000_000
            writer.write(Bytes(b"".join(part), arrived))
        writer.flush()
    session.save(metadata.closed(BEGIN_NS + round(n / rate_hz * 1e9), counters={"samples": n}))
    return folder


def _one(columns: Columns) -> None:
    n = len(columns["gyro_x"])
    for at, name in ((0.31, "gyro_y"), (0.5, "accel_x"), (0.73, "temperature"), (0.62, "mag_z")):
        columns[name][int(at * n)] = 1e10


def _at_range(columns: Columns) -> None:
    n = len(columns["gyro_x"])
    part = slice(int(0.4 * n), int(0.4 * n) + n // 200)
    columns["gyro_x"][part] = -np.radians(RANGE_DEG_S)
    columns["accel_y"][part] = RANGE_G * 9.80665


def _nan(columns: Columns) -> None:
    n = len(columns["gyro_x"])
    for at, name in ((0.31, "gyro_y"), (0.5, "accel_x"), (0.73, "temperature"), (0.62, "mag_z")):
        columns[name][int(at * n)] = np.nan


def _dead_temperature(columns: Columns) -> None:
    columns["temperature"][:] = 0.0


def _late_temperature(columns: Columns) -> None:
    columns["temperature"][: len(columns["temperature"]) // 20] = 0.0


FAULTS = {
    "one reading of 1e10 of each sensor": Fault(_one),
    "a stretch at the declared range": Fault(_at_range),
    "packets twice": Fault(twice=0.1),
    "one reading of each sensor that is none": Fault(_nan),
    "a temperature that is zero at first": Fault(_late_temperature),
    "a dead temperature": Fault(_dead_temperature),
}

"""A fleet of units: sessions with serial numbers, and models of each over months."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import yaml

from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel, TrainedOn
from imumon.recordings.folder import iso_utc
from tests.fleet.batch.sessions import tiny

DEG_PER_H = float(np.radians(1.0) / 3600.0)
SD = 0.5 * DEG_PER_H
PER_MONTH = 2.0 * DEG_PER_H
MONTH_NS = round(365.25 / 12 * 86_400e9)
BEGIN_NS = 1_767_225_600_000_000_000
RUNAWAY = "SN06"
"""Its bias is far from that of the others."""


def model_of(serial: str, month: int, session: str, constant: float) -> BiasModel:
    """Return a model with this bias at 25 °C, in rad/s."""
    curve = PolynomialCurve(
        kind="polynomial", center_degc=25.0, half_width_degc=20.0, coefficients=[constant, 1e-5]
    )
    channel = ChannelModel(
        unit="rad/s",
        temperature_column="temperature",
        temperature_range_degc=[5.0, 45.0],
        residual_sd=SD,
        curve=curve,
    )
    return BiasModel(
        made_by="imumon",
        created=iso_utc(BEGIN_NS + month * MONTH_NS)[:19] + "Z",
        device="ax1",
        serial=serial,
        trained_on=[
            TrainedOn(session=session, sha256="0" * 64, rest_s=1.0, blocks=1, temperature_range_degc=[5, 45])
        ],
        channels={
            name: channel.model_copy(
                update={"curve": curve.model_copy(update={"coefficients": [sign * constant, 1e-5]})}
            )
            for name, sign in (("gyro_x", 1.0), ("gyro_y", -1.0), ("gyro_z", 0.5))
        },
    )


def fleet(folder: Path, units: int = 6, months: int = 4) -> Path:
    """Make units of which one is unusual, each with a session and a model a month."""
    first = tiny(folder / "made", seconds=45.0, scenario="self-heating")
    text = yaml.safe_load((first / "session.yaml").read_text())
    noise = np.random.default_rng(1)
    for number in range(1, units + 1):
        serial = f"SN{number:02}"
        for month in range(months):
            path = folder / f"{serial}-{month}"
            shutil.copytree(first, path)
            begun = BEGIN_NS + month * MONTH_NS
            text |= {"created_ns": begun, "ended_ns": begun + 20_000_000_000, "serial": serial}
            (path / "session.yaml").write_text(yaml.safe_dump(text))
            constant = 20 * DEG_PER_H if serial == RUNAWAY else noise.normal(0.0, DEG_PER_H)
            constant += month * PER_MONTH + noise.normal(0.0, SD)
            model_of(serial, month, path.name, constant).write(folder / f"{path.name}.yaml")
    shutil.rmtree(first)
    return folder

"""Errors of estimates against the truth that is kept beside a simulated session."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from imumon.blocks import FloatArray, IntArray, SampleBlock
from imumon.columns import TEMPERATURES
from imumon.errors import bad_data
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import DEG_PER_H
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor
from imumon.recordings.folder import TRUTH_NAME
from imumon.recordings.source import open_recording
from imumon.recordings.table import read_table

GYROS = ("gyro_bias_x", "gyro_bias_y", "gyro_bias_z")
ESTIMATED = tuple(name.replace("temperature", "temperature_estimate") for name in TEMPERATURES)
RATES = ("rate_x", "rate_y", "rate_z")
NEEDED = ("device_time_ns", *GYROS, *RATES, *TEMPERATURES, "at_rest")
Estimate = tuple[FloatArray, FloatArray | None]
"""Values and their standard deviations, (n,) each."""


@dataclass(eq=False)
class Truth:
    """The truth of a simulated session, and the errors of what was compared with it.

    A gyro at rest cannot separate its bias from the earth's rotation.  Where the estimate does not have the
    earth's rotation removed, it is compared with the sum of both, at the attitude of the last rest.
    """

    time_ns: IntArray  # device time of each row, increasing
    # What the estimates are compared with, (n,) each: gyro_bias_{x,y,z} in rad/s, temperatures in °C.
    true: Mapping[str, FloatArray]
    at_rest: IntArray
    # Of each quantity so far, in its unit and over its sigma: number, sum of squares and largest, (2, 3).
    errors: dict[str, FloatArray] = field(default_factory=dict)

    def take(self, block: SampleBlock, estimates: Mapping[str, Estimate], *, at_rest: bool = False) -> None:
        """Compare estimates at the samples of a block.

        Estimates are by gyro_bias_{x,y,z}, rad/s, and by recorded or estimated temperatures, °C; with
        `at_rest` only those where the unit is at rest count.
        """
        time_ns = block["device_time_ns"]
        row = np.minimum(np.searchsorted(self.time_ns, time_ns), len(self.time_ns) - 1)
        matched = self.time_ns[row] == time_ns
        if at_rest:
            matched = matched & (self.at_rest[row] == 1)
        for name, (values, sigma) in estimates.items():
            true = self.true[name.replace("_estimate", "")][row]
            error = np.where(matched, values - true, np.nan)
            with np.errstate(divide="ignore", invalid="ignore"):
                both = error, error / (np.nan if sigma is None else sigma)
            sums = self.errors.setdefault(name, np.zeros((2, 3)))
            for total, of in zip(sums, both, strict=True):
                known = np.abs(of[np.isfinite(of)])
                total += len(known), known @ known, max(0.0, np.max(known, initial=0.0) - total[2])

    def through(self, blocks: Iterator[SampleBlock]) -> Iterator[SampleBlock]:
        """Pass blocks of a replay on, and compare the estimates in them."""
        sigmas = {
            name: name.replace("bias", "bias_sd").replace("estimate", "estimate_sd")
            for name in (*GYROS, *ESTIMATED)
        }
        for block in blocks:
            estimates = {
                name: (block[name], block.columns.get(sd)) for name, sd in sigmas.items() if name in block
            }
            self.take(block, estimates)
            yield block

    def as_data(self) -> dict[str, dict[str, Any]]:
        """Return the errors for ``--json``, rates in °/h."""
        found = {}
        for name, sums in self.errors.items():
            unit, factor = ("°/h", 1.0 / DEG_PER_H) if name in GYROS else ("°C", 1.0)
            count, squares, largest = sums.T
            rms = np.sqrt(squares / np.where(count > 0, count, np.nan))
            found[name] = {
                "unit": unit,
                "samples": int(count[0]),
                "rms": factor * float(rms[0]),
                "rms_over_sigma": float(rms[1]),
                "largest": factor * float(largest[0]),
            }
        return found

    def rows(self) -> dict[str, str]:
        """Return the errors as lines for a person."""
        rows = {}
        for name, errors in self.as_data().items():
            unit, ratio = errors["unit"], errors["rms_over_sigma"]
            sigma = "" if math.isnan(ratio) else f", {ratio:.2f} σ rms"
            text = f"{errors['rms']:.3g} {unit} rms{sigma}, at most {errors['largest']:.3g} {unit}"
            rows[f"error of {name}"] = text if errors["samples"] else "no estimate"
        return rows


def check_truth(sessions: Iterable[Path]) -> None:
    """Raise BAD_DATA for the first session that has no truth."""
    for session in sessions:
        if not (session / TRUTH_NAME).is_file():
            raise bad_data(
                f"{session}: there is no {TRUTH_NAME} in this session, so its errors are unknown",
                "only a session of `imumon simulate` has true values; leave --truth away",
            )


def read_truth(session: Path, *, earth_removed: bool) -> Truth:
    """Read the truth of a simulated session; raises BAD_DATA where there is none.

    `earth_removed` is whether the estimates are without the earth's rotation.
    """
    check_truth([session])
    path = session / TRUTH_NAME
    table, _ = read_table(path)
    lacking = [name for name in NEEDED if name not in table] or ["rows"] * (not len(table))
    if lacking:
        raise bad_data(f"{path}: has no {', '.join(lacking)}", "simulate the session anew")
    true, at_rest = {name: table[name] for name in (*GYROS, *TEMPERATURES)}, table["at_rest"].astype(np.int64)
    if not earth_removed:
        last = np.maximum.accumulate(np.where(at_rest == 1, np.arange(len(at_rest)), -1))
        for name, rate in zip(GYROS, RATES, strict=True):  # the rate at the last rest is the earth's
            true[name] = true[name] + np.where(last >= 0, table[rate][np.maximum(last, 0)], np.nan)
    return Truth(table["device_time_ns"].astype(np.int64), true, at_rest)


def errors_of_model(session: Path, model: BiasModel) -> Truth:
    """Compare the curves of a bias model, and the recorded temperature, with the truth of a session at rest.

    Raises BAD_DATA where the session has no truth.
    """
    truth = read_truth(session, earth_removed=model.earth_rate == "removed")
    names = [f"gyro_{axis}" for axis in "xyz" if f"gyro_{axis}" in model.channels]
    predictor = BiasPredictor(model, names)
    recording = open_recording(  # with the estimated temperatures, which the curves are over
        session, lambda device: [TemperatureRate(parameters=None if device is None else device.temperature)]
    )
    for block in recording.blocks():
        found: dict[str, Estimate] = {
            name.replace("gyro", "gyro_bias"): (values, np.full(len(block), model.channels[name].residual_sd))
            for name, values in zip(names, predictor.of_block(block).bias.T, strict=True)
        }
        found |= {name: (block[name], None) for name in TEMPERATURES if name in block}
        truth.take(block, found, at_rest=True)
    return truth

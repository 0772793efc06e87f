"""Error over sigma of the estimated attitude, over scenes, rates and seeds, beside others."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from itertools import product
from pathlib import Path
from typing import Literal, cast

import imufusion
import numpy as np
from attitude_figure import draw
from attitude_measured import HEADS as MEASURED_HEADS
from attitude_measured import measured_rows
from attitude_scenes import SCENES, Record, Scene, calibrated, simulate
from scipy.spatial.transform import Rotation
from vqf import VQF

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.attitude.fusion import heading
from imumon.estimation.attitude.parameters import AttitudeParameters
from imumon.estimation.attitude.stage import AttitudeEstimate
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import STANDARD_GRAVITY

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("IMUMON_DATA", ROOT.parent / "shared" / "data"))
RMS_BAR, LARGEST_BAR = 1.8, 7.0
RATES_HZ = (50.0, 100.0, 400.0)
HEADS = (
    "scene", "Hz", "magnetometer", "tilt °", "VQF", "imufusion", "z rms", "max", "σ °",
    "heading °", "VQF", "imufusion", "z rms", "max", "σ °", "claimed %",
)  # fmt: skip


@dataclass(eq=False)
class Kind:
    """Errors of one kind over runs: ours and others', rad, (n,) each, ours over sigma, and sigma."""

    ours: list[FloatArray] = field(default_factory=list)
    vqf: list[FloatArray] = field(default_factory=list)
    imufusion: list[FloatArray] = field(default_factory=list)
    ratios: list[FloatArray] = field(default_factory=list)
    sigma: list[FloatArray] = field(default_factory=list)

    def all(self) -> list[FloatArray]:
        """Return each, of all runs."""
        return [np.concatenate(getattr(self, one.name)) for one in fields(self)]

    def row(self) -> tuple[float, list[str], float]:
        """Return how bad it is, its cells, and the share of samples with a sigma."""
        ours, vqf, other, ratios, sigma = self.all()
        ratios = ratios[np.isfinite(ratios)]
        largest = float(np.abs(ratios).max(initial=0.0))
        cells = [f"{np.degrees(rms(error)):.2f}" for error in (ours, vqf, other)]
        cells += [f"{rms(ratios):.2f}", f"{largest:.1f}", f"{np.degrees(np.nanmedian(sigma)):.2f}"]
        return max(rms(ratios) / RMS_BAR, largest / LARGEST_BAR), cells, float(np.mean(np.isfinite(sigma)))


def rms(values: FloatArray) -> float:
    """Return the root mean square of what is known."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan


def vectors(samples: SampleBlock, name: str) -> FloatArray:
    """Return what a sensor sent, (n, 3)."""
    return np.column_stack([samples[f"{name}_{axis}"] for axis in "xyz"])


def by_vqf(samples: SampleBlock, dt: float) -> FloatArray:
    """Return the attitude by VQF with its defaults, w, x, y, z, (n, 4)."""
    gyro, accel = vectors(samples, "gyro"), vectors(samples, "accel")
    if "mag_x" in samples:
        found = VQF(dt).updateBatch(gyro, accel, vectors(samples, "mag"))
        return np.asarray(found["quat9D"])
    return np.asarray(VQF(dt).updateBatch(gyro, accel)["quat6D"])


def by_imufusion(samples: SampleBlock, dt: float) -> FloatArray:
    """Return the attitude by imufusion with the settings of its example, w, x, y, z, (n, 4)."""
    ahrs, bias = imufusion.Ahrs(), imufusion.Bias()
    rate_hz = 1.0 / dt
    settings = imufusion.AhrsSettings()
    settings.convention, settings.sample_rate = imufusion.CONVENTION_ENU, rate_hz
    settings.gain, settings.gyroscope_range = 0.5, 2000.0
    settings.acceleration_rejection = settings.magnetic_rejection = 10.0
    settings.rejection_timeout = 5.0
    ahrs.set_settings(settings)
    bias.set_settings(imufusion.BiasSettings(rate_hz, 3.0, 3.0))
    gyro, accel = np.degrees(vectors(samples, "gyro")), vectors(samples, "accel") / STANDARD_GRAVITY
    mag = vectors(samples, "mag") if "mag_x" in samples else None
    result = np.empty((len(gyro), 4))
    for i in range(len(gyro)):
        rate = bias.update(gyro[i])
        if mag is None:
            ahrs.update_no_magnetometer(rate, accel[i])
        else:
            ahrs.update(rate, accel[i], mag[i])
        result[i] = ahrs.get_quaternion()
    return result


PEERS: dict[str, Callable[[SampleBlock, float], FloatArray]] = {"vqf": by_vqf, "imufusion": by_imufusion}


def tilt_error(q: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the error about the two level axes, rad, (n, 2)."""
    off = np.einsum("nij,nkj->nik", Rotation.from_quat(q, scalar_first=True).as_matrix(), truth)
    return np.column_stack([off[:, 1, 2], off[:, 0, 2]])


def heading_error(q: FloatArray, truth: FloatArray, since: int, free: bool) -> FloatArray:
    """Return the error of the heading, rad, (n,): where it is free, of its change since a row."""
    off = heading(q) - heading(Rotation.from_matrix(truth).as_quat(scalar_first=True))
    return np.asarray(np.angle(np.exp(1j * (off - (off[since] if free else 0.0)))))


def add(tilt: Kind, turn: Kind, record: Record, with_mag: bool, dt: float, given: AttitudeParameters) -> None:
    """Run ours and others on a record, from where ours has a sigma."""
    samples = record.samples
    if not with_mag:
        columns = samples.columns.items()
        samples = SampleBlock({name: values for name, values in columns if not name.startswith("mag")})
    axes = cast(Literal["FRD", "FLU"], record.axes)
    told = samples
    attitude = AttitudeEstimate(given, axes, calibrated())
    for stage in (TemperatureRate(), RestAndBias(mode="learned"), attitude):
        told = told.with_columns(stage.process(told))
    ours = np.column_stack([told[f"attitude_estimate_{part}"] for part in "wxyz"])
    tilt_known, heading_known = (
        np.isfinite(told[f"attitude_estimate_{name}_sd"]) for name in ("tilt", "heading")
    )
    later, since, free = (
        slice(int(np.argmax(tilt_known)) + 1, None),
        int(np.argmax(heading_known)),
        not with_mag,
    )
    found = {"ours": ours, **{name: method(samples, dt) for name, method in PEERS.items()}}
    for name, q in found.items():
        getattr(tilt, name).append(tilt_error(q[later], record.attitude[later]).ravel())
        getattr(turn, name).append(heading_error(q, record.attitude, since, free)[later])
    for kind, column, wide in ((tilt, "tilt_sd", 2), (turn, "heading_sd", 1)):
        sd = np.repeat(told[f"attitude_estimate_{column}"][later], wide)
        kind.sigma.append(sd)
        kind.ratios.append(kind.ours[-1] / sd)


def row(
    name: str, rate_hz: float, with_mag: bool, records: Iterable[Record], given: AttitudeParameters
) -> tuple[float, list[str]]:
    """Return how bad a row is, and its cells."""
    tilt, turn = Kind(), Kind()
    for record in records:
        add(tilt, turn, record, with_mag, 1.0 / rate_hz, given)
    (first, tilt_cells, known), (second, turn_cells, tied) = tilt.row(), turn.row()
    cells = [name, f"{rate_hz:.0f}", "yes" if with_mag else "no", *tilt_cells, *turn_cells]
    return max(first, second), [*cells, f"{100.0 * min(known, tied):.0f}"]


def worth(scene: Scene, with_mag: bool) -> bool:
    """Return whether a scene says something with, or without, a magnetometer."""
    return with_mag or not scene.magnet


def table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table in Markdown."""
    heads = list(heads)
    return "\n".join(
        [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|", *(f"| {' | '.join(r)} |" for r in rows)]
    )


def beside(rows: list[list[str]], path: Path) -> str:
    """Return the rows beside those of another version that `--out` has saved."""
    others = {tuple(row[:3]): row for row in json.loads(path.read_text(encoding="utf-8"))}
    pairs = [(row, others[tuple(row[:3])]) for row in rows if tuple(row[:3]) in others]
    columns = (3, 6, 7, 8, 9, 12, 13, 14)  # errors, z, largest and sigma of tilt and heading
    cells = [[*new[:3], *(f"{new[j]} / {old[j]}" for j in columns)] for new, old in pairs]
    ratios = {
        name: np.exp(np.mean([np.log((float(new[j]) + 1e-3) / (float(old[j]) + 1e-3)) for new, old in pairs]))
        for name, j in (("tilt", 3), ("its sigma", 8), ("heading", 9), ("its sigma ", 14))
    }
    means = ", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items())
    heads = [*HEADS[:3], *(HEADS[j] for j in columns)]
    return f"{table(heads, cells)}\n\nThis version over the other, geometric mean: {means}."


def print_measured(data: Path, given: AttitudeParameters) -> None:
    """Print the rows of measured recordings, or why there are none."""
    folder = data / "broad"
    rows = list(measured_rows(folder, given)) if folder.is_dir() else []
    if rows:
        print(f"\n{table(MEASURED_HEADS, rows)}")
    else:
        print(f"\nMeasured rows skipped: no recordings in {folder} (set IMUMON_DATA).")


def main() -> None:
    """Print the table, worst row first."""
    parser = argparse.ArgumentParser(prog="scripts/reproduce/attitude", description=__doc__)
    parser.add_argument("--seeds", type=int, default=4, help="runs of each scene (default: %(default)s)")
    parser.add_argument("--first", type=int, default=700, help="first seed (default: %(default)s)")
    parser.add_argument("--only", choices=[*SCENES, "measured"], help="one scene, or the measured recordings")
    parser.add_argument("--rates", type=float, nargs="+", default=RATES_HZ, help="sample rates, Hz")
    parser.add_argument("--quick", action="store_true", help="some seconds of one scene at the lowest rate")
    parser.add_argument("--accel-bias", type=float, help="declared to the stage, m/s² (default: not)")
    parser.add_argument("--gyro-scale", type=float, help="declared to the stage (default: not)")
    parser.add_argument("--out", type=Path, help="save the rows as JSON")
    parser.add_argument("--beside", type=Path, help="print them beside the rows of another version")
    parser.add_argument("--figure", type=Path, help="draw the figure of docs/attitude.md there, and end")
    given = parser.parse_args()
    if given.figure:
        draw(given.figure)
        return
    declared = {"accel_bias_m_per_s2": given.accel_bias, "gyro_scale": given.gyro_scale}
    stage = AttitudeParameters(**{name: value for name, value in declared.items() if value is not None})
    seeds = range(given.first, given.first + given.seeds)
    if given.quick:
        record = simulate(SCENES["robot arm"], RATES_HZ[0], given.first, 30.0)
        print(table(HEADS, [row("robot arm", RATES_HZ[0], True, [record], stage)[1]]))
        return
    rows = [
        row(name, rate_hz, with_mag, (simulate(SCENES[name], rate_hz, seed) for seed in seeds), stage)
        for name, rate_hz, with_mag in product(SCENES, given.rates, (True, False))
        if given.only in (None, name) and worth(SCENES[name], with_mag)
    ]
    cells = [each for _, each in sorted(rows, reverse=True)]
    if rows:
        print(table(HEADS, cells))
        print(f"\nWorst over its bar (rms {RMS_BAR}, largest {LARGEST_BAR:.0f}): {max(rows)[0]:.2f}.")
    if given.out:
        given.out.write_text(json.dumps(cells), encoding="utf-8")
    if given.beside:
        print(f"\n{beside(cells, given.beside)}")
    if given.only in (None, "measured"):
        print_measured(DATA, stage)


if __name__ == "__main__":
    main()

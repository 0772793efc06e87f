"""Error over sigma of the estimated attitude, over scenes, rates and seeds, beside others."""

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import product

import broad
import imufusion
import numpy as np
from attitude_scenes import SCENES, Record, calibrated, simulate
from samples import without
from scipy.spatial.transform import Rotation
from study import Cells, Options, Study, Table, matrix, over_bar, worst_first
from study import rms as rms
from vqf import VQF

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.attitude.fusion import heading
from imumon.estimation.attitude.parameters import AttitudeParameters
from imumon.estimation.attitude.stage import AttitudeEstimate
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import STANDARD_GRAVITY

RATES_HZ = (50.0, 400.0)
HEADS = (
    "scene", "Hz", "magnetometer", "tilt °", "VQF", "imufusion", "z rms", "max", "σ °",
    "heading °", "VQF", "imufusion", "z rms", "max", "σ °", "claimed %",
)  # fmt: skip
ANGLE = (".2f", ".2f", ".2f", ".2f", ".1f", ".2f")
FORMATS = ("", ".0f", "", *ANGLE, *ANGLE, ".0f")
QUICK_S = 30.0


def by_vqf(samples: SampleBlock, dt: float) -> FloatArray:
    """Return the attitude by VQF with its defaults, w, x, y, z, (n, 4)."""
    mag = matrix(samples, "mag") if "mag_x" in samples else None
    found = VQF(dt).updateBatch(matrix(samples, "gyro"), matrix(samples, "accel"), mag)
    return np.asarray(found["quat6D" if mag is None else "quat9D"])


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
    gyro, accel = np.degrees(matrix(samples, "gyro")), matrix(samples, "accel") / STANDARD_GRAVITY
    mag = matrix(samples, "mag") if "mag_x" in samples else None
    result = np.empty((len(gyro), 4))
    for i in range(len(gyro)):
        rate = bias.update(gyro[i])
        if mag is None:
            ahrs.update_no_magnetometer(rate, accel[i])
        else:
            ahrs.update(rate, accel[i], mag[i])
        result[i] = ahrs.get_quaternion()
    return result


PEERS: dict[str, Callable[[SampleBlock, float], FloatArray]] = {"VQF": by_vqf, "imufusion": by_imufusion}


def tilt_error(q: FloatArray, truth: FloatArray) -> FloatArray:
    """Return the error about the two level axes, rad, (n, 2)."""
    off = np.einsum("nij,nkj->nik", Rotation.from_quat(q, scalar_first=True).as_matrix(), truth)
    return np.column_stack([off[:, 1, 2], off[:, 0, 2]])


def heading_error(q: FloatArray, truth: FloatArray, since: int, free: bool) -> FloatArray:
    """Return the error of the heading, rad, (n,): where it is free, of its change since a row."""
    off = heading(q) - heading(Rotation.from_matrix(truth).as_quat(scalar_first=True))
    return np.asarray(np.angle(np.exp(1j * (off - (off[since] if free else 0.0)))))


def errors(record: Record, with_mag: bool, dt: float) -> tuple[FloatArray, ...]:
    """Run ours and others on a record, from where ours has a sigma.

    Returns errors of the tilt, (methods, 2 n), and its sigma, and the same of the heading, (methods, n), rad.
    """
    samples = record.samples if with_mag else without(record.samples, "mag")
    attitude = AttitudeEstimate(AttitudeParameters(), record.axes, calibrated())
    estimated = samples
    for stage in (TemperatureRate(), RestAndBias(mode="learned"), attitude):
        estimated = estimated.with_columns(stage.process(estimated))
    ours = np.column_stack([estimated[f"attitude_estimate_{part}"] for part in "wxyz"])
    tilt_sd, heading_sd = (estimated[f"attitude_estimate_{name}_sd"] for name in ("tilt", "heading"))
    later = slice(int(np.argmax(np.isfinite(tilt_sd))) + 1, None)
    since = int(np.argmax(np.isfinite(heading_sd)))
    found = [ours, *(method(samples, dt) for method in PEERS.values())]
    tilt = [tilt_error(q[later], record.attitude[later]).ravel() for q in found]
    turn = [heading_error(q, record.attitude, since, not with_mag)[later] for q in found]
    return np.array(tilt), np.repeat(tilt_sd[later], 2), np.array(turn), heading_sd[later]


def row(name: str, rate_hz: float, with_mag: bool, records: Iterable[Record]) -> tuple[float, Cells]:
    """Return how bad a row is, and its cells."""
    runs = [errors(record, with_mag, 1.0 / rate_hz) for record in records]
    tilt, tilt_sd, turn, turn_sd = (np.concatenate(parts, axis=-1) for parts in zip(*runs, strict=True))
    claimed = 100.0 * min(float(np.mean(np.isfinite(sd))) for sd in (tilt_sd, turn_sd))
    angles = [*broad.cells(tilt, tilt_sd), *broad.cells(turn, turn_sd)]
    bad = max(over_bar(tilt[0] / tilt_sd), over_bar(turn[0] / turn_sd))
    return bad, [name, rate_hz, "yes" if with_mag else "no", *angles, claimed]


def tables(given: Options) -> Iterator[Table]:
    """Yield the simulated scenes and the measured recordings."""
    kinds = [
        (name, rate_hz, with_mag)
        for name, rate_hz, with_mag in product(SCENES, RATES_HZ, (True, False))
        if given.only in name and (with_mag or not SCENES[name].magnet)
    ]
    made = partial(simulate, seconds=QUICK_S) if given.quick else simulate
    rows = [
        row(name, rate_hz, with_mag, (made(SCENES[name], rate_hz, seed) for seed in given.seeds))
        for name, rate_hz, with_mag in kinds[: 1 if given.quick else None]
    ]
    if rows:
        note = f"Worst over its bar: {max(bad for bad, _ in rows):.2f}."
        yield Table("", HEADS, worst_first(rows), note, FORMATS)
    if given.only in ("", "measured") and not given.quick:
        found = list(broad.attitude_rows(given.data))
        note = "" if found else f"No recordings in {given.data / 'broad'}."
        yield Table("Measured", broad.HEADS, found, note, broad.FORMATS)


STUDY = Study(tables, 4, 700, "appendix/attitude-results.md")

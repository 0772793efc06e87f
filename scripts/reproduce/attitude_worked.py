"""The worked example of docs/appendix/attitude-details.md: what a sigma of the tilt is made of.

Also the case that no sigma contains: an acceleration straight ahead that lasts longer than 6 s.
"""

from collections.abc import Iterator
from unittest.mock import patch

import numpy as np
from attitude_table import tilt_error
from samples import sent
from scipy.spatial.transform import Rotation
from study import Cells, Options, Study, Table

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.attitude import stage
from imumon.estimation.attitude.sigma import SLOT_S, Slot, TiltSigma
from imumon.geodesy import STANDARD_GRAVITY

RATE_HZ, TURN_DEG, TURN_S = 50.0, 30.0, 2.0
OUT_S, BACK_S, END_S = 20.0, 32.0, 38.0
"""When it is turned, when it is turned back, and when the run ends."""
SCALE, ACCEL_OFF = 0.01, (0.049, 0.0, 0.0)
"""Of the gyro x, and of the accelerometers, m/s²: 5 milli-g."""
BIAS_SD = 5e-5
"""rad/s: 10 °/h."""
HEADS = (
    "t, s", "state", "turned °", "√(d/2) °", "√m °", "√l °", "s %", "confirmed", "σ °", "error °",
)  # fmt: skip
FORMATS = (".0f", "", ".1f", ".2f", ".2f", ".2f", ".2f", "", ".2f", ".2f")
FROM_S = 20.0
"""The first row."""
AHEAD, AHEAD_FROM_S, AHEAD_S = 2.0, 60.0, (4.0, 6.0, 8.0, 10.0, 20.0, 30.0)
"""Acceleration straight ahead, m/s², when it begins, and times since then."""


class Recorded(TiltSigma):
    """The estimate, with what each slot makes of it."""

    slots: list[tuple[float, ...]]

    def step(self, slot: Slot) -> float:
        """Take a slot and keep its terms."""
        variance = super().step(slot)
        change = float(((slot.up - self.lag[0][0]) ** 2).sum())
        late = self.not_followed(slot.up)
        terms = 0.5 * change, self.mean, late
        self.slots.append((slot.rest, *terms, self.gyros.variance, self.gyros.confirmed, variance))
        return variance


def turned(end_s: float, ahead: FloatArray | None = None) -> tuple[SampleBlock, FloatArray, FloatArray]:
    """Return samples, the angle about x, rad, (n,), and the true attitude, (n, 3, 3).

    `ahead` is an acceleration along x, m/s², (n,); without one the accelerometers are off.
    """
    t = np.arange(1, round(end_s * RATE_HZ) + 1) / RATE_HZ
    done = [np.clip((t - begin) / TURN_S, 0.0, 1.0) for begin in (OUT_S, BACK_S)]
    out, back = (part**3 * (10.0 - 15.0 * part + 6.0 * part * part) for part in done)
    angle = np.radians(TURN_DEG) * (out - back)
    pose = Rotation.from_rotvec(np.outer(angle, [1.0, 0.0, 0.0]))
    rate = np.outer((1.0 + SCALE) * np.diff(angle, prepend=0.0) * RATE_HZ, [1.0, 0.0, 0.0])
    added = np.array(ACCEL_OFF) if ahead is None else np.outer(ahead, [1.0, 0.0, 0.0])
    samples = sent(t, gyro=rate, accel=pose.inv().apply([0.0, 0.0, STANDARD_GRAVITY]) + added)
    rests = (np.abs(rate[:, 0]) < 1e-9) & (ahead is None or ahead == 0.0)
    known = {"at_rest": rests.astype(np.int64)}
    sd = {f"gyro_bias_sd_{axis}": np.full(len(t), BIAS_SD) for axis in "xyz"}
    corrected = {f"gyro_corrected_{axis}": rate[:, j] for j, axis in enumerate("xyz")}
    return samples.with_columns(known | sd | corrected), angle, pose.as_matrix()


def attitude_and_error(samples: SampleBlock, truth: FloatArray) -> tuple[SampleBlock, FloatArray]:
    """Return what the stage adds, and the error of the tilt, rad, (n,): zero before the attitude begins."""
    found = SampleBlock(dict(stage.AttitudeEstimate(axes="FLU").process(samples)))
    q = np.column_stack([found[f"attitude_estimate_{part}"] for part in "wxyz"])
    begun = int(np.argmax(np.isfinite(q[:, 0])))
    off = np.zeros(len(q))
    off[begun:] = np.linalg.norm(tilt_error(q[begun:], truth[begun:]), axis=1)
    return found, off


def tables(_: Options) -> Iterator[Table]:
    """Yield a row a second."""
    samples, angle, truth = turned(END_S)
    Recorded.slots = []
    with patch.object(stage, "TiltSigma", Recorded):
        off = attitude_and_error(samples, truth)[1]
    rows: list[Cells] = []
    for k, (rest, *squares, scale, confirmed, variance) in enumerate(Recorded.slots):
        t = SLOT_S * (k + 1)
        if t < FROM_S or t != round(t):
            continue
        at = round(t * RATE_HZ)  # the first sample behind the slot
        degrees = [float(np.degrees(np.sqrt(square))) for square in squares]
        rows.append(
            [
                t, "rest" if rest else "motion", float(np.degrees(angle[at - 1])), *degrees,
                100.0 * float(np.sqrt(scale)), "yes" if confirmed else "no",
                float(np.degrees(np.sqrt(variance))), float(np.degrees(off[at - 1])),
            ]
        )  # fmt: skip
    yield Table("", HEADS, rows, formats=FORMATS)


def straight(_: Options) -> Iterator[Table]:
    """Yield a row for each time since an acceleration straight ahead began: after both turns, and a rest."""
    t = np.arange(1, round((AHEAD_FROM_S + AHEAD_S[-1]) * RATE_HZ) + 1) / RATE_HZ
    samples, _angle, truth = turned(t[-1], np.where(t > AHEAD_FROM_S, AHEAD, 0.0))
    found, off = attitude_and_error(samples, truth)
    rows: list[Cells] = []
    for since_s in AHEAD_S:
        at = round((AHEAD_FROM_S + since_s) * RATE_HZ) - 1
        sd = float(found["attitude_estimate_tilt_sd"][at])
        rows.append([since_s, float(np.degrees(off[at])), float(np.degrees(sd)), float(off[at]) / sd])
    heads = ("s since it began", "error °", "σ °", "error/σ")
    yield Table("", heads, rows, formats=(".0f", ".2f", ".2f", ".1f"))


STUDY = Study(tables, page="appendix/attitude-details.md")
STRAIGHT = Study(straight)

"""Cases of the gyro bias in the hand and on the road, and where errors over sigma are taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from bias_sigma_records import FIRST_REST_S, LATITUDE_DEG, RATE_HZ, Case, Record, varied
from study import matrix

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.temperature_rate.stage import TemperatureRate

CASES = {
    "the default scene": varied(),
    "no sensitivity to g": varied(per_g=0.0),
    "sensitivity 0.1 °/s/g": varied(per_g=0.1),
    "rests of 3 s": varied(rest_s=3.0, rests=20),
    "rests of 60 s": varied(rest_s=60.0, rests=6),
    "motion of 5 s": varied(motion_s=5.0, rests=20),
    "motion of 600 s": varied(motion_s=600.0, rests=3),
    "ramp of 2 °C/min": varied(temperature="ramp"),
    "warm-up": varied(temperature="warm-up"),
    "tactical": varied(sensor="tactical"),
    "consumer": varied(sensor="consumer"),
    "flicker of 27 °/h beside 0.3 °/√h": varied(sensor="flickering"),
    "flicker of 27 °/h beside 0.03 °/√h": varied(sensor="all flicker"),
    "flicker of 27 °/h beside 0.3 °/√h, ramp": varied(sensor="flickering", temperature="ramp"),
    "place known": varied(place=True),
    "place known, 0.1 °/s/g": varied(place=True, per_g=0.1),
    "tactical, place known": varied(sensor="tactical", place=True),
    "tactical, place known, motion of 600 s": varied(sensor="tactical", place=True, motion_s=600.0, rests=3),
    "consumer, warm-up, 0.1 °/s/g, rests of 3 s": varied(
        sensor="consumer", temperature="warm-up", per_g=0.1, rest_s=3.0, rests=20
    ),
    "rover": varied(motion="rover", motion_s=60.0),
    "car": varied(motion="car", motion_s=60.0),
}


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Samples at the ends of rests, before the next, and all in motion, from the end of the first rest on."""

    ends: npt.NDArray[np.int64]
    before: npt.NDArray[np.int64]
    motion: npt.NDArray[np.int64]


def places(rest: npt.NDArray[np.bool_]) -> Places:
    """Return where to look."""
    moving = np.flatnonzero(~rest)
    leaves = np.flatnonzero(rest[:-1] & ~rest[1:])
    comes = np.flatnonzero(~rest[:-1] & rest[1:])
    return Places(leaves[1:], comes, moving[moving > FIRST_REST_S * RATE_HZ])


def estimated(case: Case, record: Record) -> tuple[FloatArray, FloatArray, Record]:
    """Return error and sigma of the pipeline, rad/s, (n, 3) each, and the record with its columns."""
    samples = record.samples
    known = (LATITUDE_DEG, 0.0) if case.place else (None, None)
    for stage in (TemperatureRate(), RestAndBias(None, None, "learned", *known)):
        samples = samples.with_columns(stage.process(samples))
    observable = record.bias if case.place else record.bias + record.earth
    error, sd = matrix(samples, "gyro_bias") - observable, matrix(samples, "gyro_bias_sd")
    return error, sd, Record(samples, record.bias, record.earth, record.rest)

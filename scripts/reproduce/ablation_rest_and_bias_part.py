"""What the mechanisms of rest and gyro bias are worth: units in hands, steady turns, and measured hands."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from ablations import Change, Outcome, ablation
from broad import bias_errors
from handled_units import CASES, estimated, places, simulate
from rest_scenes import SENSORS, TURN_RATE_HZ, measure_with_bias, steady_turn
from samples import sent

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias import bank, hypotheses
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.rest import odds, quiet
from imumon.geodesy import DEG_PER_H

TITLE = "Rest and gyro bias: error of the bias in hands and in steady turns, °/h."
HANDS = ("the default scene", "flicker of 27 °/h beside 0.03 °/√h", "warm-up", "sensitivity 0.1 °/s/g")
TURNS = {"0.5 °/s": (0.5, 10.0, 120.0, 0.0), "0.05 °/s": (0.05, 10.0, 0.5, 0.0)}
TILTED = {"0.5 °/s, tilted 45°": (0.5, 10.0, 120.0, 45.0)}
GRADES = {"industrial": 1, "as BMI160": 2, "as MPU-6050": 3}
LEVEL, NOISY = (0.5, 10.0, 120.0, 90.0), 5
"""A turn about a level axis, and a gyro that may take it for rest: 1.8 °/√h."""
FLOOR_DPH = 1.0
FIRST_S = 60.0
"""Of a turn, before which nothing is known of the flicker."""
VARIANTS: dict[str, Change] = {
    "one level of flicker, 10 s": [(bank, "FLICKER_CORNERS_S", (10.0,))],
    "no random walk": [(bank, "WALK_CORNER_S", 1e6)],
    "no sensitivity": [(bank, "SENSITIVITY_SD", 1e-9)],
    "no flicker within a slot": [(bank, "FASTER", 0.0)],
    "nominal bias follows at once": [(hypotheses, "LAG_S", 1.0)],
    "nominal bias never stays": [(hypotheses, "DOUBT", 1.0), (hypotheses, "UNLIKELY_TURN", 1.0)],
    "nominal bias stays from P(turn) of 0.1 on": [(hypotheses, "DOUBT", 0.1)],
    "a mean fits by 5.5 sigma, not 4.5": [(hypotheses, "FIT_SIGMAS", 5.5)],
    "no test by gravity": [(odds, "OBLIQUE", 1e9)],
    "a vague prediction does not explain a rate": [(odds, "of_nominal_bias", lambda *_: 0.0)],
    "rest after one second, however short the last rests": [(quiet, "SHORT_RUNS", 10**9)],
    "no turn may hide in the first rest": [(odds, "hidden_turn", lambda *_: np.zeros(3))],
}


def outcomes(seeds: range, data: Path) -> Iterator[Outcome]:
    """Yield the outcome of every scene with a change."""
    for name in HANDS:
        yield _outcome(name, [_in_a_hand(name, seed) for seed in seeds])
    for name, turn in {**TURNS, **TILTED}.items():
        for grade, which in GRADES.items():
            yield _outcome(f"{name}, {grade}", [_turned(turn, which, seed) for seed in seeds])
    yield _outcome("0.5 °/s about a level axis, noisy", [_turned(LEVEL, NOISY, seed) for seed in seeds])
    yield _outcome("walk of 6 °/h/√s at rest", [_walking(seed) for seed in seeds])
    yield _outcome("0.2 °/s for 1.5 s after a restart", [_restarted(seed) for seed in seeds])
    for path in sorted((data / "broad").glob("*.npz")):
        error, ratio, _ = bias_errors(path)
        yield _outcome(path.stem, [(error, ratio)])


def _in_a_hand(name: str, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return error and error over sigma at the ends of rests, before the next, and in motion."""
    record = simulate(CASES[name], seed)
    error, sd, _ = estimated(CASES[name], record)
    at, _ = places(record.rest)
    return error[at].ravel(), (error / sd)[at].ravel()


def _turned(turn: tuple[float, float, float, float], grade: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return the same before, in and after a steady turn, once a second."""
    samples, truth = measure_with_bias(steady_turn(TURN_RATE_HZ, *turn), SENSORS[grade], seed)
    samples = samples.with_columns(RestAndBias().process(samples))
    return _errors(samples, truth, TURN_RATE_HZ)


def _walking(seed: int) -> tuple[FloatArray, FloatArray]:
    """Return the same of a resting unit whose biases walk, with white noise of 1 °/√h."""
    rng, n, rate_hz = np.random.default_rng(seed), 40_000, 50.0
    walk = np.cumsum(3e-5 / np.sqrt(rate_hz) * rng.standard_normal((n, 3)), axis=0)
    gyro = walk + 3e-4 * np.sqrt(rate_hz) * rng.standard_normal((n, 3))
    accel = 0.02 * rng.standard_normal((n, 3)) + [0.0, 0.0, 9.81]
    samples = sent(np.arange(n) / rate_hz, gyro=gyro, accel=accel)
    samples = samples.with_columns(RestAndBias().process(samples))
    return _errors(samples, walk, rate_hz)


def _restarted(seed: int) -> tuple[FloatArray, FloatArray]:
    """Return the same, each quarter second, of a resting unit that restarts and then turns for 1.5 s."""
    rng, n, rate_hz = np.random.default_rng(seed), 1500, 50.0
    again = np.arange(n) >= n // 3
    t = (np.arange(n) - n // 3 * again) / rate_hz
    gyro = 3e-5 * np.sqrt(rate_hz) * rng.standard_normal((n, 3))
    gyro[again & (t < 1.5), 2] += np.radians(0.2)
    accel = 0.02 * rng.standard_normal((n, 3)) + [0.0, 0.0, 9.81]
    samples = sent(t, gyro=gyro, accel=accel).with_columns({"segment": again.astype(np.int64)})
    samples = samples.with_columns(RestAndBias().process(samples))
    return _errors(samples, np.zeros((n, 3)), rate_hz, first_s=0.0, every_s=0.25)


def _errors(
    samples: SampleBlock, truth: FloatArray, rate_hz: float, first_s: float = FIRST_S, every_s: float = 1.0
) -> tuple[FloatArray, FloatArray]:
    """Return error and error over sigma of the bias."""
    at = slice(round(first_s * rate_hz), None, round(every_s * rate_hz))
    bias, sd = (
        np.column_stack([samples[f"{name}_{axis}"] for axis in "xyz"])[at]
        for name in ("gyro_bias", "gyro_bias_sd")
    )
    error = bias - truth[at]
    return error.ravel(), (error / sd).ravel()


def _outcome(scene: str, found: list[tuple[FloatArray, FloatArray]]) -> Outcome:
    error, ratio = (np.concatenate(each) for each in zip(*found, strict=True))
    rms = float(np.sqrt(np.nanmean(error**2))) / DEG_PER_H
    return Outcome(
        scene, rms, FLOOR_DPH, float(np.sqrt(np.nanmean(ratio**2))), float(np.nanmax(np.abs(ratio)))
    )


STUDY = ablation(TITLE, VARIANTS, outcomes)

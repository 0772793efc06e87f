"""Results as remarks, as JSON, as the noise section of a pipeline, and for Kalibr."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from imumon.config import dump_yaml
from imumon.errors import bad_data
from imumon.files import write_text
from imumon.run.setup import FORMAT

from .analysis import Result
from .covariance import CONFIDENCE, TERMS_OF
from .fit import AMBIGUOUS, DIGITS, NO_SUM
from .recording import UNITS, by_text, group_of


def remarks(results: Mapping[str, Result]) -> list[str]:
    """Return why terms are less certain or missing, or from a part of the curve, with their channels."""
    found = by_text(
        (f"{name} {detail}".rstrip(), sentence)
        for name, result in results.items()
        for sentence, detail in _remarks(result, UNITS[group_of(name)])
    )
    return [f"{', '.join(names)}: {sentence}" for sentence, names in found.items()]


def _remarks(result: Result, unit: str) -> Iterator[tuple[str, str]]:
    """Yield sentences about one channel, each with the number that goes with it."""
    fit, digits, tau_s = result.fit, result.digits, result.tau_s
    if fit is None:
        stuck = "the reading never changes: the channel is stuck, or its resolution too coarse; no terms"
        yield ("too short for a fit of the terms" if result.allan.values.any() else stuck), ""
        return
    hidden, disturbance = fit.withheld == DIGITS, "(a vibration, a cycle, motion?)"
    if fit.first > 0:
        yield (
            "shorter averaging times are not fitted: no sum of the terms describes them (a filter?)",
            f"{tau_s[fit.first]:.2g} s",
        )
    if fit.model_error > NO_SUM and not hidden:
        yield f"no sum of the terms describes the curve {disturbance}: no term is reported", ""
    elif fit.model_error > 0.0 and not hidden:
        yield (
            "the curve differs so much from every sum of the terms; the standard deviations take that in",
            f"{50.0 * fit.model_error:.2g} %",
        )
    if fit.last < result.trusted - 1:
        yield (
            f"no sum of the terms describes longer averaging times {disturbance}: "
            "only the angle random walk is reported",
            f"{tau_s[fit.last]:.2g} s",
        )
    if fit.withheld == AMBIGUOUS:
        yield (
            "correlated noise describes the curve as well as bias instability or a random walk: "
            "neither is reported; record for longer",
            "",
        )
    if digits is not None:
        steps = f"{digits.step:.3g} {unit}, {1.0 / digits.ratio:.2g} times the noise"
        walk = fit.terms["angle_random_walk"]
        if hidden:
            yield "the steps of the readings hide the noise: no term is reported", steps
        elif walk is not None and 0.5 * digits.share * walk.value > walk.sd:
            yield "the steps of the readings add to the noise", f"{steps}, {digits.share:.0%} of the variance"


def as_json(results: Mapping[str, Result]) -> dict[str, Any]:
    """Return what ``--json`` prints, one entry per channel; a term that the data do not show is null."""
    return {name: _channel(group_of(name), result) for name, result in results.items()}


def _channel(group: str, result: Result) -> dict[str, Any]:
    fit, series, digits = result.fit, result.series, result.digits
    kinds = {"oadev": result.allan, "mdev": result.modified, "ohdev": result.hadamard}
    return {
        "tau_s": result.tau_s.tolist(),
        **{name: of.values.tolist() for name, of in kinds.items()},
        "unit": UNITS[group],
        **{
            name: {**term._asdict(), "unit": style.unit} if (term := result.term(name)) else None
            for name, style in TERMS_OF[group].items()
        },
        "longest_tau_s": result.longest_tau_s,
        "confidence": CONFIDENCE,
        **{
            f"{name}_interval": {"low": of.low.tolist(), "high": of.high.tolist()}
            for name, of in kinds.items()
        },
        "noise": result.noise,
        "fit_tau_s": None if fit is None else result.tau_s[[fit.first, fit.last]].tolist(),
        "model_error": None if fit is None else fit.model_error,
        "withheld": None if fit is None else fit.withheld or None,
        "step": None if digits is None else digits.step,
        "noise_in_steps": None if digits is None else digits.ratio,
        "rate_hz": series.rate_hz,
        "samples": series.used,
        "samples_left_out": series.samples - series.used,
        "samples_missing": int(series.gap_lengths.sum()),
        "pieces": len(series.islands) - 1,
        "duration_s": series.duration_s,
    }


def value_of(result: Result | None, term: str) -> float | None:
    """Return a term in SI units, None where the data do not show it."""
    estimate = None if result is None else result.term(term)
    return None if estimate is None else _rounded(estimate.value)


def write_noise(path: Path, results: Mapping[str, Result], source: Path) -> None:
    """Write a pipeline file that states the noise: the terms in SI units per sensor, each for x, y, z.

    Raises OSError when the file cannot be written; one that was there before is untouched.
    """
    section = {
        group: {
            style.key: [value_of(results.get(f"{group}_{axis}"), term) for axis in "xyz"]
            for term, style in styles.items()
        }
        for group, styles in TERMS_OF.items()
        if group in map(group_of, results)
    }
    head = (
        f"# Noise of {source.name}, by Allan deviation; x, y, z; null: the data do not show it.\n"
        "# SI units.  Bias instability B: the flat part of the Allan deviation is 0.664 B.\n"
    )
    write_text(path, head + dump_yaml({"format": FORMAT, "noise": section}, flow=None))


def write_kalibr(path: Path, results: Mapping[str, Result], source: Path) -> None:
    """Write Kalibr's imu.yaml: densities N and K of continuous time (its wiki, IMU Noise Model), worst axis.

    Raises BAD_DATA when a sensor is missing or shows no white noise; OSError when the file cannot be written.
    """
    head = (
        f"# Noise of {source.name}, by Allan deviation; the largest of the three axes.\n"
        "# rostopic is a guess: name your own.\n"
    )
    body: dict[str, Any] = {}
    for group, name in {"accel": "accelerometer", "gyro": "gyroscope"}.items():
        axes = [results.get(f"{group}_{axis}") for axis in "xyz"]
        white, walk = (
            max((value for result in axes if (value := value_of(result, term)) is not None), default=None)
            for term in ("angle_random_walk", "rate_random_walk")
        )
        if white is None:
            raise bad_data(f"odometry needs a noise density of the {name}, and the data show none")
        if walk is None:
            head += f"# {name}_random_walk: the data show none; 0 is not a fact of the sensor.\n"
        body[f"{name}_noise_density"] = white
        body[f"{name}_random_walk"] = 0.0 if walk is None else walk
    some = next(result for name, result in results.items() if name.startswith("gyro"))
    body |= {"rostopic": "/imu0", "update_rate": _rounded(some.series.rate_hz)}
    write_text(path, head + dump_yaml(body, flow=False))


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")

"""Results as JSON, as the noise section of a pipeline, and as Kalibr reads them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from imumon.allan.analysis import Deviations, Result
from imumon.allan.confidence import CONFIDENCE
from imumon.allan.fit import TERMS, Estimate
from imumon.allan.recording import GROUPS, UNITS, group_of, rate_hz
from imumon.blocks import FloatArray
from imumon.config import dump_yaml
from imumon.errors import ImumonError, Reason
from imumon.files import check_output

UNIT_OF_TERM = {
    "gyro": {
        "angle_random_walk": "rad/sqrt(s)",
        "bias_instability": "rad/s",
        "rate_random_walk": "rad/s/sqrt(s)",
        "quantization": "rad",
        "rate_ramp": "rad/s^2",
    },
    "accel": {
        "angle_random_walk": "m/s/sqrt(s)",
        "bias_instability": "m/s^2",
        "rate_random_walk": "m/s^2/sqrt(s)",
        "quantization": "m/s",
        "rate_ramp": "m/s^3",
    },
}
NOISE_KEYS = {
    "gyro": {
        "angle_random_walk": "angle_random_walk_rad_per_sqrt_s",
        "bias_instability": "bias_instability_rad_per_s",
        "rate_random_walk": "rate_random_walk_rad_per_s_sqrt_s",
        "quantization": "quantization_rad",
        "rate_ramp": "rate_ramp_rad_per_s2",
    },
    "accel": {
        "angle_random_walk": "velocity_random_walk_m_per_s_sqrt_s",
        "bias_instability": "bias_instability_m_per_s2",
        "rate_random_walk": "acceleration_random_walk_m_per_s2_sqrt_s",
        "quantization": "quantization_m_per_s",
        "rate_ramp": "acceleration_ramp_m_per_s3",
    },
}
KALIBR_NAMES = {"gyro": "gyroscope", "accel": "accelerometer"}


def check_outputs(plot: Path | None, *files: Path | None) -> None:
    """Refuse outputs that could not be written, or would replace what a person may have edited.

    Raises
    ------
    ImumonError
        EXISTS for a file that is there (a picture is replaced); BAD_CONFIG for a picture that is not a PNG,
        and where there is no folder.
    """
    if plot is not None and plot.suffix.lower() != ".png":
        raise ImumonError(Reason.BAD_CONFIG, f"{plot}: the picture is a PNG", "name it NAME.png")
    for path in (plot, *files):
        if path is not None:
            check_output(path, replace=path is plot)


def as_json(results: Mapping[str, Result]) -> dict[str, Any]:
    """Return what ``--json`` prints, one entry per channel; a term that the data do not show is null."""
    return {name: _channel(name, result) for name, result in results.items()}


def _channel(name: str, result: Result) -> dict[str, Any]:
    units, fit, series = UNIT_OF_TERM[group_of(name)], result.fit, result.series
    terms = {term.name: _estimate(fit.terms[term.name] if fit else None, units[term.name]) for term in TERMS}
    return {
        "tau_s": _numbers(result.tau_s),
        "oadev": _numbers(result.allan.values),
        "unit": UNITS[group_of(name)],
        **terms,
        "longest_tau_s": result.longest_tau_s,
        "confidence": CONFIDENCE,
        "oadev_interval": _interval(result.allan),
        "mdev": _numbers(result.modified.values),
        "mdev_interval": _interval(result.modified),
        "ohdev": _numbers(result.hadamard.values),
        "ohdev_interval": _interval(result.hadamard),
        "noise": list(result.noise),
        "fit_tau_s": None if fit is None else _numbers(result.tau_s[[fit.first, fit.last]]),
        "model_error": None if fit is None else fit.model_error,
        "rate_hz": rate_hz(series),
        "samples": series.used,
        "samples_left_out": series.samples - series.used,
        "samples_missing": int(series.gap_lengths.sum()),
        "pieces": len(series.islands) - 1,
        "duration_s": series.duration_s,
    }


def _estimate(estimate: Estimate | None, unit: str) -> dict[str, object] | None:
    return None if estimate is None else {"value": estimate.value, "sd": estimate.sd, "unit": unit}


def _numbers(values: FloatArray) -> list[float]:
    return [float(value) for value in values]


def _interval(deviations: Deviations) -> dict[str, list[float]]:
    return {"low": _numbers(deviations.low), "high": _numbers(deviations.high)}


def noise_section(results: Mapping[str, Result]) -> dict[str, dict[str, list[float | None]]]:
    """Return the terms in SI units, per sensor, each a list for x, y, z; None for what is not shown."""
    section: dict[str, dict[str, list[float | None]]] = {}
    for group in GROUPS:
        axes = [results.get(f"{group}_{axis}") for axis in "xyz"]
        if any(axes):
            section[group] = {
                key: [_value(result, term) for result in axes] for term, key in NOISE_KEYS[group].items()
            }
    return section


def _value(result: Result | None, term: str) -> float | None:
    if result is None or result.fit is None:
        return None
    estimate = result.fit.terms[term]
    return None if estimate is None else float(f"{estimate.value:.6g}")


def write_noise(path: Path, results: Mapping[str, Result], source: Path) -> None:
    """Write the noise section of a pipeline YAML.

    Raises
    ------
    ImumonError
        BAD_CONFIG when the file cannot be written.
    """
    head = [
        f"# Noise of {source.name}, by Allan deviation; x, y, z; null: the data do not show it.",
        "# SI units.  Bias instability B: the flat part of the Allan deviation is 0.664 B.",
    ]
    _write(path, "\n".join(head) + "\n" + dump_yaml({"noise": noise_section(results)}, flow=None))


def write_kalibr(path: Path, results: Mapping[str, Result], source: Path) -> None:
    """Write the noise as Kalibr's imu.yaml has it: the largest of the axes, continuous-time densities.

    Raises
    ------
    ImumonError
        BAD_DATA when a sensor is missing or shows no white noise; BAD_CONFIG when the file cannot be written.
    """
    head = [
        f"# Noise of {source.name}, by Allan deviation; the largest of the three axes.",
        "# rostopic is a guess: name your own.",
    ]
    body: dict[str, Any] = {}
    for group in ("accel", "gyro"):
        name = KALIBR_NAMES[group]
        white = _largest(results, group, "angle_random_walk")
        walk = _largest(results, group, "rate_random_walk")
        if white is None:
            raise ImumonError(
                Reason.BAD_DATA, f"Kalibr needs a noise density of the {name}, and the data show none"
            )
        if walk is None:
            head.append(f"# {name}_random_walk: the data show none; 0 is not a fact of the sensor.")
        body[f"{name}_noise_density"] = white
        body[f"{name}_random_walk"] = 0.0 if walk is None else walk
    body["rostopic"] = "/imu0"
    body["update_rate"] = float(f"{rate_hz(results['gyro_x'].series):.6g}") if "gyro_x" in results else None
    _write(path, "\n".join(head) + "\n" + dump_yaml(body, flow=False))


def _largest(results: Mapping[str, Result], group: str, term: str) -> float | None:
    values = [_value(results.get(f"{group}_{axis}"), term) for axis in "xyz"]
    return max((value for value in values if value is not None), default=None)


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ImumonError(Reason.BAD_CONFIG, f"{path}: cannot be written: {error.strerror}") from error

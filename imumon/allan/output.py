"""Results as JSON, and as the noise section of a pipeline."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from imumon.allan.analysis import Deviations, Result
from imumon.allan.confidence import CONFIDENCE
from imumon.allan.fit import Estimate
from imumon.allan.parameters import TERMS_OF
from imumon.allan.recording import GROUPS, UNITS, group_of, rate_hz
from imumon.config import dump_yaml
from imumon.errors import ImumonError, Reason
from imumon.files import check_output, write_text


def check_outputs(plot: Path | None, *files: Path | None) -> None:
    """Refuse outputs that could not be written, or would replace what a person may have edited.

    Raises EXISTS for a file that is there (a picture is replaced); BAD_CONFIG for a picture that is not a
    PNG, and where there is no folder.
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
    style, fit, series = TERMS_OF[group_of(name)], result.fit, result.series
    terms = {name: _estimate(fit.terms[name] if fit else None, term.unit) for name, term in style.items()}
    return {
        "tau_s": result.tau_s.tolist(),
        "oadev": result.allan.values.tolist(),
        "unit": UNITS[group_of(name)],
        **terms,
        "longest_tau_s": result.longest_tau_s,
        "confidence": CONFIDENCE,
        "oadev_interval": _interval(result.allan),
        "mdev": result.modified.values.tolist(),
        "mdev_interval": _interval(result.modified),
        "ohdev": result.hadamard.values.tolist(),
        "ohdev_interval": _interval(result.hadamard),
        "noise": list(result.noise),
        "fit_tau_s": None if fit is None else result.tau_s[[fit.first, fit.last]].tolist(),
        "model_error": None if fit is None else fit.model_error,
        "withheld": None if fit is None else fit.withheld or None,
        "step": None if result.digits is None else result.digits.step,
        "noise_in_steps": None if result.digits is None else result.digits.ratio,
        "rate_hz": rate_hz(series),
        "samples": series.used,
        "samples_left_out": series.samples - series.used,
        "samples_missing": int(series.gap_lengths.sum()),
        "pieces": len(series.islands) - 1,
        "duration_s": series.duration_s,
    }


def _estimate(estimate: Estimate | None, unit: str) -> dict[str, object] | None:
    return None if estimate is None else {"value": estimate.value, "sd": estimate.sd, "unit": unit}


def _interval(deviations: Deviations) -> dict[str, list[float]]:
    return {"low": deviations.low.tolist(), "high": deviations.high.tolist()}


def noise_section(results: Mapping[str, Result]) -> dict[str, dict[str, list[float | None]]]:
    """Return the terms in SI units, per sensor, each a list for x, y, z; None for what is not shown."""
    section: dict[str, dict[str, list[float | None]]] = {}
    for group in GROUPS:
        axes = [results.get(f"{group}_{axis}") for axis in "xyz"]
        if any(axes):
            section[group] = {
                style.key: [value_of(result, term) for result in axes]
                for term, style in TERMS_OF[group].items()
            }
    return section


def value_of(result: Result | None, term: str) -> float | None:
    """Return a term in SI units, None where the data do not show it."""
    if result is None or result.fit is None:
        return None
    estimate = result.fit.terms[term]
    return None if estimate is None else float(f"{estimate.value:.6g}")


def write_noise(path: Path, results: Mapping[str, Result], source: Path) -> None:
    """Write the noise section of a pipeline YAML.

    Raises OSError when the file cannot be written; one that was there before is untouched.
    """
    head = [
        f"# Noise of {source.name}, by Allan deviation; x, y, z; null: the data do not show it.",
        "# SI units.  Bias instability B: the flat part of the Allan deviation is 0.664 B.",
    ]
    write_text(path, "\n".join(head) + "\n" + dump_yaml({"noise": noise_section(results)}, flow=None))

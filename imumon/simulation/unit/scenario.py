"""Scenario files: which unit, where and how it stands, what the chamber does, and how it is moved.

A scenario or a unit may name a `base` of its kind: what it does not say itself, the base says.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

from pydantic import Field, field_validator, model_validator

from imumon.config import StrictModel, load_yaml, parse_yaml
from imumon.errors import ImumonError, Reason
from imumon.files import read_text
from imumon.simulation.unit.events import Event
from imumon.simulation.unit.parameters import UnitParameters

FORMAT = "imumon-scenario/1"


class Attitude(StrictModel):
    """How the unit's forward-right-down axes stand to north-east-down (ZYX); for FLU y and z are turned."""

    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    heading_deg: float = 0.0


class Step(StrictModel):
    """One step of a chamber: to a temperature at a rate (where there is one), then hold."""

    to_degc: float | None = None
    rate_degc_per_min: float | None = Field(default=None, gt=0.0)
    hold_s: float = Field(default=0.0, ge=0.0)

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if (self.to_degc is None) != (self.rate_degc_per_min is None):
            raise ValueError("to_degc and rate_degc_per_min go together")
        if self.to_degc is None and not self.hold_s:
            raise ValueError("expected to_degc with rate_degc_per_min, or hold_s, or all three")
        return self


class Wobble(StrictModel):
    """A sine on top of the chamber's temperature."""

    amplitude_degc: float
    period_s: float = Field(gt=0.0)


class Chamber(StrictModel):
    """The temperature around the unit; after the last step it stays.

    Parameters
    ----------
    start_degc : float
        Temperature at power-on, of chamber and unit.
    steps : list of Step
    wobble : Wobble or None
    lag_s : float
        Time constant with which the unit follows the chamber, a first-order filter; 0: at once.
    """

    start_degc: float
    steps: list[Step] = Field(default_factory=list)
    wobble: Wobble | None = None
    lag_s: float = Field(default=0.0, ge=0.0)


class Unit(UnitParameters):
    """A unit in a scenario: named, written out, or a base with changes."""

    base: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _on_base(cls, given: Any) -> Any:
        if not isinstance(given, dict) or not isinstance(given.get("base"), str):
            return given
        return _filled(given, load_unit(_known(given["base"], unit_names(), "unit")))


class Scenario(StrictModel):
    """A scenario, complete: everything that `imumon.simulation.unit.SimulatedUnit` needs but the seed.

    Parameters
    ----------
    unit : Unit
        The name of a file of configs/units, a path, or a mapping.
    rate_hz, duration_s : float
        Packets per second; how long the scenario lasts (a unit goes on after that, as it is).
    axes : "FRD" or "FLU"
        Body axes of the unit.
    latitude_deg, gravity_m_per_s2 : float
        They give the earth rate and the specific force at rest.
    """

    format: Literal["imumon-scenario/1"]
    title: str = ""
    base: str | None = None
    unit: Unit
    rate_hz: float = Field(gt=0.0, le=10_000.0)
    duration_s: float = Field(gt=0.0, le=1e7)
    axes: Literal["FRD", "FLU"] = "FRD"
    latitude_deg: float = Field(ge=-90.0, le=90.0)
    gravity_m_per_s2: float = Field(default=9.80665, gt=9.0, lt=10.0)
    attitude: Attitude = Attitude()
    chamber: Chamber
    motion: list[Event] = Field(default_factory=list)

    @field_validator("unit", mode="before")
    @classmethod
    def _named_unit(cls, given: Any) -> Any:
        return load_unit(_known(given, unit_names(), "unit")) if isinstance(given, str) else given

    @model_validator(mode="before")
    @classmethod
    def _on_base(cls, given: Any) -> Any:
        if not isinstance(given, dict) or not isinstance(given.get("base"), str):
            return given
        return _filled(given, load_scenario(_known(given["base"], scenario_names(), "scenario")))

    @property
    def samples(self) -> int:
        """Number of samples from power-on to the end."""
        return max(int(self.duration_s * self.rate_hz + 0.5), 1)

    def played(self, rate_hz: float, axes: Literal["FRD", "FLU"]) -> Scenario:
        """Return the scenario as a device plays it, at its packet rate and in its body axes."""
        return self.model_copy(update={"rate_hz": rate_hz, "axes": axes})


class _Header(StrictModel, extra="ignore"):
    """What tells whether a file may serve as a base."""

    base: str | None = None


def load_scenario(name: str | Path) -> Scenario:
    """Read a scenario by its known name or the path of its file.

    Raises
    ------
    ImumonError
        BAD_CONFIG, naming file and line, what was found and what was expected.
    """
    path = _path(name, "scenarios", "scenario", scenario_names())
    return _load(path, Scenario)


def load_unit(name: str | Path) -> Unit:
    """Read a unit by its known name or the path of its file.

    Raises
    ------
    ImumonError
        BAD_CONFIG, naming file and line, what was found and what was expected.
    """
    return _load(_path(name, "units", "unit", unit_names()), Unit)


def scenario_names() -> list[str]:
    """Return the names that `load_scenario` knows without a path."""
    return _names("scenarios")


def unit_names() -> list[str]:
    """Return the names that `load_unit` knows without a path."""
    return _names("units")


Loaded = TypeVar("Loaded", Scenario, Unit)


def _load(path: Path, model: type[Loaded]) -> Loaded:
    text = read_text(path)
    base = parse_yaml(text, _Header, str(path)).base
    if base is not None:
        _refuse_chain(_path(base, *_KINDS[model.__name__], _names(_KINDS[model.__name__][0])), base, path)
    return parse_yaml(text, model, str(path))


_KINDS = {"Scenario": ("scenarios", "scenario"), "Unit": ("units", "unit")}


def _refuse_chain(base: Path, name: str, path: Path) -> None:
    """Raise when a base has a base itself: a chain may be a circle, and is hard to read."""
    if load_yaml(base, _Header).base is not None:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"{path}: its base {name!r} has a base itself",
            "name that one, and repeat the changes",
        )


def _filled(given: dict[str, Any], base: Scenario | Unit) -> dict[str, Any]:
    """Return the keys given, and for those that are not the values of the base; complete, so without base."""
    return {name: getattr(base, name) for name in type(base).model_fields} | given | {"base": None}


def _known(name: str, names: Iterable[str], kind: str) -> str:
    """Return the name; a ValueError, which becomes an error with file and line, when there is none such."""
    if not _looks_like_path(name) and name not in names:
        raise ValueError(f"no {kind} {name!r}; there are {', '.join(names)}, or give a path (NAME.yaml)")
    return name


def _path(name: str | Path, folder: str, kind: str, names: list[str]) -> Path:
    if isinstance(name, Path) or _looks_like_path(name):
        return Path(name)
    if name not in names:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"no {kind} {name!r}",
            f"there are: {', '.join(names)}; or give the path of a file (NAME.yaml)",
        )
    return _folder(folder) / f"{name}.yaml"


def _looks_like_path(name: str) -> bool:
    return name.endswith((".yaml", ".yml")) or "/" in name


def _names(folder: str) -> list[str]:
    return sorted(path.stem for path in _folder(folder).glob("*.yaml"))


def _folder(name: str) -> Path:
    packaged = Path(__file__).resolve().parents[2] / "configs" / name
    return packaged if packaged.is_dir() else Path(__file__).resolve().parents[3] / "configs" / name

"""Scenario files: which unit, where and how it stands, what the chamber does, and how it is moved.

A scenario or a unit may name a `base` of its kind: what it does not state itself, the base states.
"""

from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from imumon.columns import KNOWN, BodyAxes
from imumon.config import StrictModel, load_yaml, parse_yaml
from imumon.effects.base import ACCEL
from imumon.errors import ImumonError, bad_config
from imumon.files import bundled, read_text

from .motion import Attitude, Event
from .parameters import NotNegative, Positive, Thermometer, UnitParameters

FREE = {"pressure", "latitude", "longitude", "altitude"}
"""Known columns that a driver may be; the unit sends others itself."""


class _Based(StrictModel):
    """What is read from a file of its kind, and may name a base."""

    kind: ClassVar[str]  # its word in messages; with an s the folder of those that come along

    base: str | None = None

    @classmethod
    def load(cls, name: str | Path) -> Self:
        """Read one by its known name or the path of its file.

        Raises BAD_CONFIG, naming file and line, what was found and what was expected.
        """
        path = cls._path(name)
        text = read_text(path)
        base = parse_yaml(text, _Header, str(path)).base
        # A chain may be a circle, and is hard to read.
        if base is not None and load_yaml(cls._path(base), _Header).base is not None:
            raise bad_config(
                f"{path}: its base {base!r} has a base itself", "name that one, and repeat the changes"
            )
        return parse_yaml(text, cls, str(path))

    @classmethod
    def named(cls, name: str) -> Self:
        """Do as `load`; a wrong name is a ValueError, which becomes an error with file and line."""
        try:
            cls._path(name)
        except ImumonError as error:
            raise ValueError(f"{error.seen}; {error.hint}") from error
        return cls.load(name)

    @classmethod
    def _path(cls, name: str | Path) -> Path:
        if isinstance(name, Path) or name.endswith((".yaml", ".yml")) or "/" in name:
            return Path(name)
        there = bundled(f"{cls.kind}s")
        if name not in there:
            raise bad_config(
                f"no {cls.kind} {name!r}", f"there are {', '.join(sorted(there))}, or give a path (NAME.yaml)"
            )
        return there[name]

    @model_validator(mode="before")
    @classmethod
    def _on_base(cls, given: Any) -> Any:
        """Fill in the values of the base for the keys that are not given; complete, so without base."""
        if not isinstance(given, dict) or not isinstance(given.get("base"), str):
            return given
        base = cls.named(given["base"])
        return {name: getattr(base, name) for name in cls.model_fields} | given | {"base": None}


class _Header(StrictModel, extra="ignore"):
    """What shows whether a file may serve as a base."""

    base: str | None = None


class Step(StrictModel):
    """One step of a chamber: to a temperature at a rate (where there is one), then hold."""

    to_degc: float | None = None
    rate_degc_per_min: Positive | None = None
    hold_s: NotNegative = 0.0

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
    period_s: Positive


class ChamberLog(StrictModel):
    """Two thermometers on a computer of their own: at the chamber's inner wall, and on the unit's case."""

    interval_s: Positive = 10.0
    thermometer: Thermometer = Thermometer(step_degc=0.1, noise_degc=0.05)
    """Of either; the default is a thermocouple behind a data logger."""


class Chamber(StrictModel):
    """The temperature around the unit; after the last step it stays."""

    start_degc: float  # at power-on, of chamber and unit
    steps: list[Step] = Field(default_factory=list)
    wobble: Wobble | None = None
    lag_s: NotNegative = 0.0  # time constant of the unit behind the chamber; 0: none
    log: ChamberLog | None = None  # what is logged of the chamber beside the unit


class Unit(UnitParameters, _Based):
    """A unit in a scenario: named, written out, or a base with changes."""

    kind = "unit"


class Course(StrictModel):
    """What a further sensor shows: straight between its corners, held after the last, with white noise."""

    unit: str
    at_s: list[float] = Field(min_length=1)
    value: list[float] = Field(min_length=1)  # the corners, times since power-on increasing
    noise: NotNegative = 0.0  # standard deviation of a reading

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.at_s) != len(self.value):
            raise ValueError(f"{len(self.at_s)} times for {len(self.value)} values")
        if any(b <= a for a, b in pairwise(self.at_s)):
            raise ValueError("at_s does not increase")
        return self


class Scenario(_Based):
    """A scenario, complete: everything that `imumon.simulation.unit.SimulatedUnit` needs but the seed."""

    kind = "scenario"

    format: Literal["imumon-scenario/1"]
    title: str = ""
    unit: Unit
    """The name of a file of configs/units, a path, or a mapping."""
    rate_hz: float = Field(gt=0.0, le=10_000.0)
    duration_s: float = Field(gt=0.0, le=1e7)
    """Packets per second; how long the scenario lasts (a unit goes on after that, as it is)."""
    axes: BodyAxes = "FRD"
    """Body axes of the unit."""
    latitude_deg: float = Field(ge=-90.0, le=90.0)
    gravity_m_per_s2: float = Field(default=9.80665, gt=9.0, lt=10.0)
    """They give the earth rate and the specific force at rest."""
    attitude: Attitude = Attitude()
    chamber: Chamber
    motion: list[Event] = Field(default_factory=list)
    drivers: dict[str, Course] = Field(default_factory=dict)
    """Further columns; effects of the unit may depend on them."""

    @model_validator(mode="after")
    def _has_what_drives_the_unit(self) -> Self:
        if own := sorted(self.drivers.keys() & KNOWN.keys() - FREE):
            raise ValueError(f"drivers: {own[0]} is a column of the unit itself; give it another name")
        unit = self.unit
        for effects in (unit.gyro_effects_deg_per_h, unit.accel_effects_ug):
            for effect in (*effects.x, *effects.y, *effects.z):
                if lacking := [n for n in effect.inputs if n != ACCEL and n not in self.drivers]:
                    raise ValueError(f"{effect.label} of the unit needs {lacking[0]} among the drivers")
        return self

    @field_validator("unit", mode="before")
    @classmethod
    def _named_unit(cls, given: Any) -> Any:
        return Unit.named(given) if isinstance(given, str) else given

    @property
    def samples(self) -> int:
        """Number of samples from power-on to the end."""
        return max(int(self.duration_s * self.rate_hz + 0.5), 1)

    def played(self, rate_hz: float, axes: BodyAxes) -> "Scenario":
        """Return the scenario as a device plays it, at its packet rate and in its body axes."""
        return self.model_copy(update={"rate_hz": rate_hz, "axes": axes})


load_scenario, load_unit = Scenario.load, Unit.load

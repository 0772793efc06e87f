"""A bias that follows its driver: late, behind a lag or a fixed time later; in a loop; or as its rate."""

from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import Field, FiniteFloat

from imumon.blocks import BoolArray, FloatArray

from .base import (
    RATIO,
    Drive,
    DrivenEffect,
    Memory,
    NotNegative,
    Positive,
    ScaledEffect,
    Survey,
    logarithmic,
)
from .temperature_curve import MORE_DEGREES

SHORTEST_S = 20.0
"""A lag or delay that is shorter is a rate in means of 30 s."""
HIGHEST_ORDER = 9
OWN_LAG_S = 30.0
"""Time constant of a gyro's lag behind the thermometer that no model states.  Assumed."""
SPACING_S = 0.25
"""One temperature is remembered of each such interval; the temperature of a unit is straight in between."""
START_SD_DEGC = 1.0
"""How far from equilibrium a unit is at power-on, where nothing better is known (standard deviation)."""
SHARES = (0.05, 0.1, 0.2, 0.4)
"""Half widths of a loop of another driver, of its span."""
SLACK_DEGC = 0.15
"""Way of the thermometer that its noise and its steps make up."""

Shape = Literal["play", "smooth"]


class Follower(ScaledEffect):
    """u^k - v^k, k = 1 .. order: u the driver, v what follows it, both as (driver - middle) / half span.

    Of another driver than the temperature, which no declared curve is over, u is a column as well, the last.
    """

    order: Annotated[int, Field(ge=1, le=HIGHEST_ORDER)] = 1

    @property
    def width(self) -> int:
        """One for each power, and that of the driver itself."""
        return self.order + (not self.of_temperature)

    @classmethod
    def forms(cls, survey: Survey) -> list[dict[str, Any]]:
        """Return orders and scale to try: none at constant temperature, the cubic where runs can show it."""
        if not survey.thermal:
            return []
        orders = (1, 3) if may_sum(survey, 4) else (1,)
        return [{"order": order, **survey.scale._asdict()} for order in orders]

    @classmethod
    def of_curve(cls, survey: Survey) -> list[Self]:
        """Return those of at least the declared powers; none for one run with fewer than two turns."""
        every = [max(survey.degree, 1) + more for more in (0, *MORE_DEGREES)]
        orders = [order for order in every if order <= HIGHEST_ORDER]
        linear = [one for one in cls.grid(survey) if one.order == 1] if may_sum(survey, 2) else []
        return [one.model_copy(update={"order": order}) for order in orders for one in linear]

    def follow(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return what follows the driver, (n,), and carry the memory along."""
        raise NotImplementedError

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return the differences of powers, ahead less following."""
        ahead, behind = self._powers(drive.of(self.driver)), self._powers(self.follow(memory, drive))
        late = ahead - behind
        return late if self.of_temperature else np.column_stack([late, ahead[:, :1]])

    def _powers(self, values: FloatArray) -> FloatArray:
        u = (values - self.middle) / self.half_span
        powers = np.empty((len(u), self.order), order="F")
        powers[:, 0] = u
        for k in range(1, self.order):
            powers[:, k] = powers[:, k - 1] * u
        return powers


def may_sum(survey: Survey, reversals: int) -> bool:
    """Return whether the runs can show more than one term of a kind: two runs, or so many turns."""
    return survey.runs > 1 or survey.reversals >= reversals


class ThermalLag(Follower):
    """What follows is the driver behind a first-order lag.

    `start_sd` is how far what follows (the sensor's temperature) may be from its driver (the thermometer's)
    at power-on.
    """

    kind: Literal["thermal_lag"] = "thermal_lag"
    operator = "lag"
    nonlinear = ("time_constant_s",)
    free_start = True
    suspected_by = ("temperature rate",)
    time_constant_s: Positive
    start_sd: NotNegative = START_SD_DEGC

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return time constants up to a quarter of the shortest run."""
        return [
            cls(time_constant_s=tau, **form)
            for form in cls.forms(survey)
            for tau in logarithmic(SHORTEST_S, survey.shortest_s / 4)
        ]

    @classmethod
    def driven(cls, survey: Survey, driver: str) -> list[Self]:
        """Return time constants up to a quarter of the shortest run; power-on finds it in equilibrium."""
        scale = survey.others[driver]._asdict()
        return [
            cls(driver=driver, time_constant_s=tau, start_sd=0.0, **scale)
            for tau in logarithmic(SHORTEST_S, survey.shortest_s / 4, RATIO**2)
        ]

    def follow(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return the lagged driver."""
        from .operators import first_order

        time, values = drive.time_s, drive.of(self.driver)
        before = memory.time_s, memory.driver, memory.follower
        lagged = first_order(time, values, self.time_constant_s, *before)
        if len(lagged):
            memory.time_s, memory.driver, memory.follower = time[-1], values[-1], lagged[-1]
        return lagged

    def starts(self, drive: Drive) -> tuple[Memory, Memory]:
        """Return a sensor colder and one warmer than its thermometer by the standard deviation."""
        first = drive.of(self.driver)[0]
        low, high = (first + sign * self.start_sd for sign in (-1.0, 1.0))
        return Memory(0.0, first, low), Memory(0.0, first, high)

    def with_start(self, start: FloatArray) -> Self:
        """Return it with the rms of the starts in training as `start_sd`, at least 1 °C or what it was."""
        if not start.size or not self.coefficients[0]:
            return self
        rms = float(np.sqrt(np.mean(start**2))) * self.start_sd / abs(self.coefficients[0])
        return self.model_copy(update={"start_sd": max(min(START_SD_DEGC, self.start_sd), rms)})


class DeadTime(Follower):
    """The bias follows the temperature of a while ago: a pure delay, as heat takes through a housing.

    Before power-on the temperature is taken for that of the first sample.
    """

    kind: Literal["dead_time"] = "dead_time"
    operator = "delay"
    nonlinear = ("delay_s",)
    suspected_by = ("temperature rate",)
    delay_s: Annotated[FiniteFloat, Field(ge=SPACING_S)]

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return delays up to an eighth of the shortest run."""
        return [
            cls(delay_s=delay, **form)
            for form in cls.forms(survey)
            for delay in logarithmic(SHORTEST_S, survey.shortest_s / 8)
        ]

    def follow(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return the delayed temperature, between those remembered on a straight line."""
        time, values = drive.time_s, drive.of(self.driver)
        if not len(time):
            return values
        interval = np.floor(np.concatenate([[memory.time_s], time]) / SPACING_S)
        new = np.column_stack([time, values])[~(interval[1:] <= interval[:-1])]
        past = np.concatenate([memory.past, new])
        needed = np.searchsorted(past[:, 0], time[-1] - self.delay_s, side="right") - 1
        memory.time_s, memory.past = time[-1], past[max(needed, 0) :]
        return np.asarray(np.interp(time - self.delay_s, past[:, 0], past[:, 1]))

    def settled(self, drive: Drive) -> BoolArray:
        """Return whether the delay has passed: what was before power-on is not known."""
        return drive.time_s > self.delay_s


class Hysteresis(Follower):
    """What follows is dragged along with a backlash of this half width, or in a smooth loop (Dahl's).

    The powers let its width change with temperature.  A smooth loop goes behind a backlash of half width
    `slack`, so that the noise of a thermometer moves nothing.
    """

    kind: Literal["hysteresis"] = "hysteresis"
    operator = "loop"
    nonlinear = ("half_width",)
    start_share = 3.0**-0.5  # equally likely anywhere between its ends
    suspected_by = ("temperature", "temperature rate")
    half_width: Positive
    shape: Shape = "play"
    slack: NotNegative = SLACK_DEGC

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return widths from twice the slack up to half the span."""
        return [
            cls(half_width=width, shape=shape, **form)
            for form in cls.forms(survey)
            for shape in get_args(Shape)
            for width in logarithmic(2 * SLACK_DEGC, survey.span_degc / 2)
        ]

    @classmethod
    def driven(cls, survey: Survey, driver: str) -> list[Self]:
        """Return backlashes of a tenth to four fifths of the span."""
        scale = survey.others[driver]._asdict()
        return [
            cls(driver=driver, half_width=share * 2 * scale["half_span"], slack=0.0, **scale)
            for share in SHARES
        ]

    @classmethod
    def of_curve(cls, survey: Survey) -> list[Self]:  # noqa: ARG003 - whatever the runs can show
        """Return none: a loop of the third order bends as well."""
        return []

    def follow(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return what is dragged along."""
        from .operators import play, smooth_loop

        values = drive.of(self.driver)
        if not len(values):
            return values
        if self.shape == "play":
            dragged = play(values, self.half_width, memory.follower)
            memory.follower = dragged[-1]
            return dragged
        steady = play(values, self.slack, memory.driver)
        ahead = smooth_loop(steady, self.half_width, memory.driver, memory.ahead)
        memory.driver, memory.ahead = steady[-1], ahead[-1]
        return values - ahead

    def starts(self, drive: Drive) -> tuple[Memory, Memory]:
        """Return the ends between which a loop can be."""
        first = drive.of(self.driver)[0]
        low = Memory(driver=first, follower=first + self.half_width, ahead=-self.half_width)
        return low, Memory(driver=first, follower=first - self.half_width, ahead=self.half_width)


class TemperatureRate(DrivenEffect):
    """The rate of the driver behind a first-order filter of `smoothing_s`, in its unit per second."""

    kind: Literal["temperature_rate"] = "temperature_rate"
    operator = "rate"
    suspected_by = ("temperature rate",)
    smoothing_s: Positive = 15.0

    @property
    def nonlinear(self) -> tuple[str, ...]:  # type: ignore[override]  # it depends on the driver
        """The filter, where another driver has its own; that of the temperature is for its steps."""
        return () if self.of_temperature else ("smoothing_s",)

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return the one there is; none at constant temperature."""
        return [cls()] if survey.thermal else []

    @classmethod
    def driven(cls, survey: Survey, driver: str) -> list[Self]:  # noqa: ARG003 - whatever varies has a rate
        """Return one behind each of five filters, of 5 to 41 s."""
        return [cls(driver=driver, smoothing_s=seconds) for seconds in logarithmic(5.0, 41.0, RATIO**2)]

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return the filtered rate: how far a lag is behind, over its time constant."""
        lag = ThermalLag(driver=self.driver, time_constant_s=self.smoothing_s, middle=0.0, half_span=1.0)
        return lag.advance(memory, drive)[:, :1] / self.smoothing_s

"""Heading of a unit at rest by the fixed-gain loop of Lee et al., Sensors 2020, 20(8), 2188, as printed.

The strapdown attitude C (body to east-north-up) is turned by the gyros less the control rates, which the
horizontal velocities drive so that they vanish (figure 3, equations 4 to 7):

    v' = (C f)_h - k v,   ω_Ec = -k_b v_N,   ω_Nc = k_b v_E,   C' = C [ω×] - [(Ω + ω_c)×] C

Each horizontal channel has the characteristic s² + k s + k_b g; k = 2 ζ ω_n, k_b = ω_n² / g.  At rest the
control rates are what the frame turns by besides the earth's rate, so that (18) with
β_E = mean ω_Ec and β_N = Ω cos L + mean ω_Nc the frame's heading is off by arctan(β_E / β_N).  The mean is

- the total average (28), α(T) / T with α the integral of ω_c, or
- the curve fit (30, 31), the slope a of the least-squares line a t + b through α(t).

An accelerometer that warms up, δa (1 - exp(-t/T_i)), puts an error into both (19, 22, 29): there is no sigma
in the paper, and so there is none here.  The paper runs the loop at 200 Hz; here it runs on means of
`SLOT_S`, with the poles of each step at exactly exp(s h), so that it is stable at any rate.
"""

import math
from collections.abc import Sequence

import numpy as np

from imumon.blocks import Columns, FloatArray, SampleBlock
from imumon.columns import Column
from imumon.filters.turns import rotation_by
from imumon.geodesy import STANDARD_GRAVITY, earth_rate_along, heading_of

from .slot_stage import SlotStage, inertial

SLOT_S = 0.125
"""The loop follows errors of minutes; faster than this it only passes on noise, which the means take away."""
LONGEST_GAP_S = 2.0
"""After a longer gap the alignment begins anew."""
COLUMNS = tuple(
    Column(name, unit, description=text)
    for name, unit, text in (
        ("fixed_gain_loop_heading", "rad", "heading by the control rates of now"),
        ("fixed_gain_loop_control_rate_east", "rad/s", "control rate east of the fixed-gain loop"),
        ("fixed_gain_loop_control_rate_north", "rad/s", "control rate north of the fixed-gain loop"),
        ("total_average_heading", "rad", "heading by the total average of the control rates"),
        ("curve_fit_heading", "rad", "heading by the line through the integral of the control rates"),
    )
)
COARSE_S = 30.0
"""s of averaging that the loop starts from."""
CORNER, DAMPING = 4.0 * math.pi, 0.7
"""ω_n in rad/s (2 Hz) and ζ of the loop, as in the paper's figures."""


def gains(interval_s: float) -> tuple[float, float]:
    """Return the decay of a velocity, exp(-k h), and k_b in rad/m that place the poles at exp(s h)."""
    decay = math.exp(-2.0 * DAMPING * CORNER * interval_s)
    angle = CORNER * interval_s * math.sqrt(1.0 - DAMPING * DAMPING)
    trace = 2.0 * math.exp(-DAMPING * CORNER * interval_s) * math.cos(angle)
    return decay, (1.0 + decay - trace) / (interval_s**2 * STANDARD_GRAVITY)


def coarse(rate: FloatArray, force: FloatArray) -> FloatArray:
    """Return C from the mean rate and specific force at rest, body axes: up, and the earth's rate north."""
    up = force / np.linalg.norm(force)
    north = rate - (rate @ up) * up
    north /= np.linalg.norm(north)
    return np.vstack([np.cross(north, up), north, up])


class Loop:
    """The loop, and the means of its control rates ω_Ec, ω_Nc, rad/s, (2,).

    `attitude`: C at the start, body to east-north-up, (3, 3).
    `earth` (3,): Ω east, north, up, rad/s.
    """

    def __init__(self, attitude: FloatArray, earth: FloatArray) -> None:
        self.attitude, self._earth = attitude, earth
        self.velocity, self.control = np.zeros(2), np.full(2, np.nan)
        """East, north, m/s and rad/s."""
        self._seconds, self._angle = 0.0, np.zeros(2)
        self._normal, self._right = np.zeros((2, 2)), np.zeros((2, 2))
        """Time and α, the integral of the control rates; HᵀH and Hᵀα of a line a t + b, H of rows [t, 1]."""

    def step(self, interval_s: float, rate: FloatArray, force: FloatArray) -> None:
        """Go on by one step (4 to 7); `rate`, `force` (3,): rad/s and m/s², body axes."""
        decay, kb = gains(interval_s)
        frame = self.attitude @ rate - self._earth
        self.velocity = decay * self.velocity + interval_s * (self.attitude @ force)[:2]
        self.control = kb * np.array([-self.velocity[1], self.velocity[0]])
        frame[:2] -= self.control
        self.attitude = rotation_by(interval_s * frame) @ self.attitude
        self._seconds += interval_s
        self._angle = self._angle + interval_s * self.control
        row = np.array([self._seconds, 1.0])
        self._normal = self._normal + np.outer(row, row)
        self._right = self._right + np.outer(row, self._angle)

    @property
    def means(self) -> FloatArray:
        """The rates of now, their total average (28), and a of the curve fit (30, 31), (3, 2)."""
        slope = np.full(2, np.nan)
        if self._normal[1, 1] >= 2.0:
            slope = np.linalg.solve(self._normal, self._right)[0]
        return np.array([self.control, self._angle / self._seconds, slope])

    def results(self) -> FloatArray:
        """Return the values of `COLUMNS`, after a step."""
        frame, means = heading_of(self.attitude[2], self.attitude[1]), self.means
        heading = (frame - np.arctan2(means[:, 0], self._earth[1] + means[:, 1])) % (2.0 * math.pi)  # (18)
        return np.array([heading[0], *self.control, *heading[1:]])


class SelfAlignment(SlotStage):
    """The published alignment as a stage; it begins anew after motion, a gap or a restart of the device.

    `latitude`: rad.
    `methods`: those whose columns are given: "fixed_gain_loop", "total_average" or "curve_fit".
    """

    def __init__(self, latitude: float, methods: Sequence[str]) -> None:
        super().__init__(7, SLOT_S, len(COLUMNS))
        _, north, up = np.eye(3)
        self._earth = earth_rate_along(up, north, latitude)
        self.columns = [column for column in COLUMNS if column.name.startswith(tuple(methods))]
        self._begin()
        self._middle_ns = 0

    def _begin(self) -> None:
        self._loop: Loop | None = None
        self._seconds, self._sensed = 0.0, np.zeros(6)
        """Time, and integral of rates and specific forces, until there is a loop."""

    def process(self, block: SampleBlock) -> Columns:
        """Return the new columns of a block, NaN where there is no heading.

        Needs ``device_time_ns``, ``segment``, gyros and accelerometers; uses ``at_rest``.
        """
        rests = block.columns.get("at_rest", np.ones(len(block))) != 0
        slots, breaks = self.slots(block, np.column_stack([inertial(block), rests]))
        results = np.full((len(slots), len(COLUMNS)), np.nan)
        for k in range(len(slots)):
            elapsed = (slots.middle_ns[k] - self._middle_ns) * 1e-9
            self._middle_ns = slots.middle_ns[k]
            if slots.begins[k] or slots.smallest[k, 6] == 0.0 or elapsed > LONGEST_GAP_S:
                self._begin()
                elapsed = SLOT_S
            mean = slots.mean[k]
            if np.isfinite(mean).all() and slots.smallest[k, 6] == 1.0:
                # Whole slots: their middles differ by a sample as the samples fall.
                self._take(mean[:6], SLOT_S * max(round(elapsed / SLOT_S), 1))
            if self._loop is not None and np.isfinite(self._loop.control[0]):
                results[k] = self._loop.results()
        found = zip(COLUMNS, self.spread(slots.row, results, breaks, len(block)).T, strict=True)
        return {column.name: values for column, values in found if column in self.columns}

    def _take(self, sensed: FloatArray, interval_s: float) -> None:
        """Take in the mean rates and specific forces of a slot, (6,): coarse at first, then the loop."""
        if self._loop is not None:
            self._loop.step(interval_s, sensed[:3], sensed[3:])
            return
        self._seconds += interval_s
        self._sensed = self._sensed + interval_s * sensed
        if self._seconds >= COARSE_S:
            self._loop = Loop(coarse(self._sensed[:3], self._sensed[3:]), self._earth)

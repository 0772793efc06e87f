"""Detection and false-alarm rates of the rest detector, and its delays, as tables in Markdown."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product

import numpy as np
import numpy.typing as npt
from rest_detector_scenes import GRADES, SCENES, Grade, averaged, measure

from imumon.blocks import FloatArray
from imumon.estimation.rest.stage import RestDetector

RATES_HZ = (100.0, 10.0, 2.0)
FULL_RATE_HZ = RATES_HZ[0]
SECONDS, LONG_S = 200.0, 600.0
HEADER = """\
| scene | sensors | rest found % | motion missed % | motion after s | rest after s | left per h |
|---|---|---|---|---|---|---|"""
Mask = npt.NDArray[np.bool_]


@dataclass
class Tally:
    """Sums over runs: seconds of rest and of motion, those found, delays in s, and rests left wrongly."""

    rest: float = 0.0
    rest_found: float = 0.0
    motion: float = 0.0
    motion_missed: float = 0.0
    to_motion: list[float] = field(default_factory=list)
    to_rest: list[float] = field(default_factory=list)
    left: int = 0

    def add(self, t: FloatArray, rest: Mask, found: Mask) -> None:
        """Add a run: times, truth, and what was found."""
        dt = t[1] - t[0]
        self.rest += rest.sum() * dt
        self.rest_found += (rest & found).sum() * dt
        self.motion += (~rest).sum() * dt
        self.motion_missed += (~rest & found).sum() * dt
        edges = np.flatnonzero(np.diff(rest.astype(int))) + 1
        ends = np.append(edges, len(t))[1:]
        for begin, end in zip(edges, ends, strict=True):
            part = found[begin:end]
            other = part if rest[begin] else ~part
            after = float(t[begin + np.argmax(other)] - t[begin]) if other.any() else np.inf
            if rest[begin]:
                self.to_rest.append(after)
            elif found[begin - 3]:
                self.to_motion.append(after)
        leaves = np.flatnonzero(found[:-1] & ~found[1:]) + 1
        self.left += int((rest[leaves] & rest[np.minimum(leaves + 2, len(t) - 1)]).sum())

    def row(self) -> str:
        """Return the cells of a table."""
        found = f"{100 * self.rest_found / self.rest:.1f}" if self.rest else "-"
        missed = f"{100 * self.motion_missed / self.motion:.1f}" if self.motion else "-"
        per_hour = f"{3600 * self.left / self.rest:.1f}" if self.rest else "-"
        return f"{found} | {missed} | {_delays(self.to_motion)} | {_delays(self.to_rest)} | {per_hour}"


def _delays(values: list[float]) -> str:
    if not values:
        return "-"
    median, worst = np.median(values), max(values)
    texts = ["not" if np.isinf(value) else f"{value:.2f}" for value in (median, worst)]
    return " / ".join(texts)


def tally(name: str, grades: Sequence[Grade], rate_hz: float, seconds: float, seeds: int) -> Tally:
    """Run a scene with some grades of sensors, over seeds; lower rates are means of samples at 100 Hz."""
    result, count = Tally(), round(FULL_RATE_HZ / rate_hz)
    for grade, seed in product(grades, range(seeds)):
        scene = SCENES[name](FULL_RATE_HZ, seconds, seed)
        samples = averaged(measure(scene, grade, seed), count)
        found = RestDetector().process(samples)["at_rest"] == 1
        last = slice(count - 1, len(scene.t) // count * count, count)
        result.add(scene.t[last], scene.rest[last], found)
    return result


def main() -> None:
    """Print a table for each rate, and one of long rests."""
    parser = argparse.ArgumentParser(prog="scripts/reproduce/rest_detector", description=__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="runs of each scene (default: %(default)s)")
    seeds = parser.parse_args().seeds
    print("# Rest detector: tables\n\nMade by `scripts/reproduce/rest_detector`.\n")
    single = {grade.name: (grade,) for grade in GRADES}
    for rate_hz in RATES_HZ:
        print(f"### {rate_hz:g} Hz, {seeds} seeds of {SECONDS:.0f} s\n\n{HEADER}")
        groups = single if rate_hz == FULL_RATE_HZ else {"all five grades": GRADES}
        for name, (sensors, grades) in product(SCENES, groups.items()):
            print(
                f"| {name} | {sensors} | {tally(name, grades, rate_hz, SECONDS, seeds).row()} |", flush=True
            )
        print()
    print(f"### {FULL_RATE_HZ:g} Hz, {seeds} seeds of {LONG_S:.0f} s\n\n{HEADER}")
    for name, (sensors, grades) in product(("still", "temperature ramp"), single.items()):
        print(
            f"| {name} | {sensors} | {tally(name, grades, FULL_RATE_HZ, LONG_S, seeds).row()} |", flush=True
        )


if __name__ == "__main__":
    main()

"""A device file proposed from lines of text that nobody described: what the columns may be, and why.

It is a proposal: statistics of a unit at rest tell specific force from rates, but not deg/s from rad/s.  The
reasons stand beside each field, for somebody to confirm.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from imumon.blocks import FloatArray
from imumon.protocols.text import NUMBER, Line

LEAST_LINES: Final = 20
"""Lines of one kind from which columns are proposed."""
SAME: Final = 0.8
"""Share of the lines that must be of one kind: others are headers, comments, torn lines."""
GRAVITIES: Final = {
    9.80665: ("m/s^2", "1"), 1.0: ("g", "1"), 1000.0: ("mg", "1"),
    16384.0: ("g", "1/16384"), 8192.0: ("g", "1/8192"), 4096.0: ("g", "1/4096"),
    2048.0: ("g", "1/2048"), 256.0: ("g", "1/256"),
}  # fmt: skip
"""What the norm of the specific force at rest is, in units and counts that are usual; with unit and scale."""
NEAR: Final = 0.06
"""Offset and scale errors of a sensor that nobody calibrated: a few percent of gravity."""
STEADY: Final = 0.05
"""Scatter of a norm, relative, up to which it is that of a constant vector."""
FIELDS: Final = {(20.0, 70.0): "uT", (0.2, 0.7): "gauss", (200.0, 700.0): "mgauss"}
"""Norms of the magnetic field of the earth."""
UNITS: Final = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "ns": 1e-9}
QUANTITIES: Final = {
    "accel": re.compile(r"^(imu[._ ]?)?a(cc(el(eration)?)?)?[._ ]?([xyz012])$", re.I),
    "gyro": re.compile(r"^(imu[._ ]?)?(g(yro?)?|w|omega|rate)[._ ]?([xyz012])$", re.I),
    "mag": re.compile(r"^(imu[._ ]?)?m(ag)?[._ ]?([xyz012])$", re.I),
}
NAMED_TEMPERATURE: Final = re.compile(r"^t(emp(erature)?)?([._ ]?(c|degc))?$", re.I)
TIMES: Final = re.compile(r"^(t|time|ts|timestamp|millis|micros|time_(us|ms|s))$", re.I)


Keys = Mapping[str, Any]
"""Keys of the description of a line."""


@dataclass(frozen=True, slots=True)
class _Guess:
    """A field: its first column, how many, and what stands in the file for it."""

    first: int
    count: int
    keys: str
    why: str


@dataclass(frozen=True, slots=True)
class _Lines:
    """Lines of one kind: keys of its description, names of the columns or "", and numbers, (n, m)."""

    keys: Keys
    names: Sequence[str]
    numbers: FloatArray
    by_key: bool


def propose(data: bytes, seconds: float, baudrate: int | None) -> str | None:
    """Return the text of a device file for lines of text; None when there are not enough of one kind.

    Parameters
    ----------
    data : bytes
        What came; the first and the last line may be torn.
    seconds : float
        Time in which it came.
    baudrate : int or None
        Rate in bit/s at which it came.
    """
    lines = [line.strip("\r") for line in data.decode("ascii", "replace").split("\n")[1:-1]]
    lines = [line for line in lines if line.strip()]
    if len(lines) < LEAST_LINES:
        return None
    kinds: tuple[Callable[[list[str]], _Lines | None], ...] = (_json, _pairs, _delimited)
    found = next((kind for read in kinds if (kind := read(lines)) is not None), None)
    if found is None:
        return None
    rate = len(found.numbers) / seconds if seconds > 0 else 0.0
    guesses = _guesses(found, rate)
    text = [
        "# Proposed from what came; every reason stands beside its line.  Look at it before you trust it.",
        "format: imumon-device/1", "name: proposed", "title: proposed from lines of text",
        'verified: "nothing: proposed from the stream"', "protocol: text",
        "axes: FLU  # cannot be seen: x forward, y left, z up, or FRD",
        f"rate_hz: {rate:.3g}  # {len(found.numbers)} lines in {seconds:.2g} s",
        f"serial: {{baudrates: [{baudrate or 115_200}]}}", "lines:", "  - name: line",
        *(f"    {key}: {json.dumps(value)}" for key, value in found.keys.items()), "    fields:",
    ]  # fmt: skip
    for guess in guesses:
        place = json.dumps(_stem(found.names, guess)) if found.by_key else str(guess.first)
        text.append(f"      # {guess.why}")
        text.append(f"      - {{{'key' if found.by_key else 'at'}: {place}, {guess.keys}}}")
    return "\n".join(text) + "\n"


def _stem(names: Sequence[str], guess: _Guess) -> str:
    """Return the key of a field: of several columns the part before ".0"."""
    name = names[guess.first]
    return name if guess.count == 1 else name.rpartition(".")[0]


def _read(keys: Keys, fields: Sequence[Any], lines: Sequence[str]) -> FloatArray | None:
    """Return the numbers of the lines that are of a kind, (n, m), when nearly all are."""
    line = Line.model_validate({**keys, "name": "line", "fields": fields})
    rows = [numbers for text in lines if (numbers := line.read(text)) is not None]
    return np.array(rows) if len(rows) >= max(LEAST_LINES, SAME * len(lines)) else None


def _leaves(tree: Any, path: str = "") -> list[str]:
    """Return the paths to the numbers of a JSON value."""
    if isinstance(tree, dict | list):
        items = tree.items() if isinstance(tree, dict) else enumerate(tree)
        return [
            leaf for key, branch in items for leaf in _leaves(branch, f"{path}.{key}" if path else str(key))
        ]
    return [path] if isinstance(tree, int | float) and not isinstance(tree, bool) else []


def _json(lines: list[str]) -> _Lines | None:
    shapes: Counter[tuple[str, ...]] = Counter()
    for text in lines:
        try:
            shapes[tuple(_leaves(json.loads(text)))] += 1
        except (ValueError, RecursionError):
            continue
    return _keyed({"form": "json"}, shapes, lines)


def _pairs(lines: list[str]) -> _Lines | None:
    for separator in (",", ";", "\t", " "):
        shapes: Counter[tuple[str, ...]] = Counter()
        for text in lines:
            words = [re.split("[:=]", word, maxsplit=1) for word in text.split(separator)]
            pairs = [word for word in words if len(word) == 2 and NUMBER.fullmatch(word[1].strip())]
            if len(pairs) == len(words):
                shapes[tuple(name.strip() for name, _ in pairs)] += 1
        found = _keyed({"form": "pairs", "separator": separator}, shapes, lines)
        if found is not None:
            return found
    return None


def _keyed(keys: Keys, shapes: Counter[tuple[str, ...]], lines: list[str]) -> _Lines | None:
    if not shapes or not shapes.most_common(1)[0][0]:
        return None
    names = shapes.most_common(1)[0][0]
    fields = [{"key": name, "column": f"value_{k}"} for k, name in enumerate(names)]
    numbers = _read(keys, fields, lines)
    return None if numbers is None else _Lines(keys, names, numbers, True)


def _delimited(lines: list[str]) -> _Lines | None:
    for prefix, checksum in _beginnings(lines):
        bodies = [x.rpartition("*")[0] if checksum else x for x in lines if x.startswith(prefix)]
        for separator in (",", ";", "\t", "|", " "):
            apart = None if separator == " " else separator
            rows = [body[len(prefix) :].split(apart) for body in bodies]
            size = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
            whole = [row for row in rows if len(row) == size]
            numeric = [
                k
                for k in range(size)
                if sum(bool(NUMBER.fullmatch(row[k].strip())) for row in whole) >= SAME * len(rows)
            ]
            if not numeric or (size == 1 and separator != " "):
                continue
            keys = {"prefix": prefix, "separator": separator, "values": size}
            keys["checksum"] = "xor8" if checksum else "none"
            fields = [{"at": k, "column": f"value_{k}"} for k in numeric]
            numbers = _read(keys, fields, [x for x in lines if x.startswith(prefix)])
            if numbers is not None:
                all_columns = np.full((len(numbers), size), np.nan)
                all_columns[:, numeric] = numbers
                headers = (h.lstrip("#% ").split(apart) for h in lines if not any(c.isdigit() for c in h))
                names = next((h for h in headers if len(h) == size), [""] * size)
                return _Lines(keys, [name.strip() for name in names], all_columns, False)
    return None


def _beginnings(lines: list[str]) -> list[tuple[str, bool]]:
    """Return the usual beginnings of lines, none last, and whether a checksum ends these lines."""
    found = Counter(re.match(r"[^0-9+\-.]*", text)[0] for text in lines)  # type: ignore[index]  # it may be empty
    usual = [
        begin for begin, n in found.most_common() if n >= max(LEAST_LINES, 0.2 * len(lines)) and begin.strip()
    ]
    starred = sum(bool(re.search(r"\*[0-9A-Fa-f]{2}\s*$", text)) for text in lines) >= SAME * len(lines)
    return [*((begin, starred and begin.startswith("$")) for begin in usual), ("", False)]


def _guesses(found: _Lines, rate: float) -> list[_Guess]:
    """Return what the columns are taken for, in their order."""
    x, names = found.numbers, found.names
    free = set(range(x.shape[1])) - {k for k in range(x.shape[1]) if np.isnan(x[:, k]).all()}
    guesses: list[_Guess] = []

    def take(guess: _Guess | None) -> None:
        if guess is not None:
            free.difference_update(range(guess.first, guess.first + guess.count))
            guesses.append(guess)

    for k in sorted(free):
        take(_time(x[:, k], k, names[k], rate))
    for size, tell in ((4, _quaternion), (3, _vector)):
        for k in range(x.shape[1] - size + 1):
            together = {*range(k, k + size)} <= free
            if together and (not found.by_key or _listed(names[k : k + size])):
                take(tell(x[:, k : k + size], k, names[k : k + size], rate))
    for k in sorted(free):
        if found.by_key:
            take(_of_axis(x, names, k))
    for k in sorted(free):
        take(_temperature(x[:, k], k, names[k]))
    for k in sorted(free):
        take(_Guess(k, 1, f"column: {_own_name(names[k], k)}", "nothing tells what it is"))
    return sorted(guesses, key=lambda guess: guess.first)


def _listed(names: Sequence[str]) -> bool:
    """Return whether names are the elements of one list."""
    stems = {name.rpartition(".")[0] for name in names}
    return len(stems) == 1 and "" not in stems and all(n.endswith(f".{k}") for k, n in enumerate(names))


def _own_name(name: str, k: int) -> str:
    plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
    return f"{plain}_raw" if plain and plain[0].isalpha() else f"value_{k}"


def _time(x: FloatArray, k: int, name: str, rate: float) -> _Guess | None:
    step = np.diff(x)
    middle = float(np.median(step)) if len(step) else 0.0
    if middle <= 0 or np.mean(step > 0) < SAME:
        return None
    whole = bool(np.all(x == np.rint(x)))
    for unit, size in UNITS.items():
        ratio = middle * size * rate
        if 0.7 < ratio < 1.4:
            kind = "type: u32, " if whole else ""
            why = f"rises by {middle:.6g} a line: at {rate:.4g} lines a second that is {unit}"
            return _Guess(k, 1, f"{kind}column: device_ticks, unit: {unit}", why)
    if whole and middle == 1.0:
        return _Guess(k, 1, "type: u32, column: packet_counter", "rises by one a line")
    return (
        _Guess(k, 1, "column: time_raw", "rises, in no unit that fits the rate")
        if TIMES.match(name)
        else None
    )


def _quaternion(x: FloatArray, k: int, names: Sequence[str], rate: float) -> _Guess | None:
    del names, rate
    norm = np.linalg.norm(x, axis=1)
    if np.all(np.abs(norm - 1) < 0.01) and np.all(np.abs(x) <= 1):
        return _Guess(
            k, 4, "columns: [q_w, q_x, q_y, q_z]", "the norm of the four is 1; the order is a guess"
        )
    return None


def _named(names: Sequence[str]) -> str | None:
    """Return the quantity that the names of three columns tell."""
    return next((what for what, pattern in QUANTITIES.items() if all(map(pattern.match, names))), None)


def _vector(x: FloatArray, k: int, names: Sequence[str], rate: float) -> _Guess | None:
    del rate
    norm = np.linalg.norm(x, axis=1)
    mean, scatter = float(norm.mean()), float(norm.std())
    steady = mean > 0 and scatter < STEADY * mean
    named = _named(names)
    how = f"named so; norm {mean:.4g} with scatter {scatter:.2g}" if named else f"norm {mean:.4g}, steady"
    gravity = next((g for g in GRAVITIES if abs(mean / g - 1) < NEAR), None) if steady else None
    if gravity is not None and named in (None, "accel"):
        unit, scale = GRAVITIES[gravity]
        scale = "" if scale == "1" else f", scale: {scale}"
        return _Guess(
            k, 3, f"columns: {_columns('accel')}{scale}, unit: {unit}", f"{how}: gravity is {gravity:g}"
        )
    if steady and named in (None, "mag"):
        for (low, high), unit in FIELDS.items():
            if low <= mean <= high:
                return _Guess(
                    k, 3, f"columns: {_columns('mag')}, unit: {unit}", f"{how}: as the earth's field"
                )
    if named == "gyro" or (named is None and _about_zero(x)):
        why = "named so" if named else "about zero on all three axes"
        unit = "deg/s"
        return _Guess(k, 3, f"columns: {_columns('gyro')}, unit: {unit}",
                      f"{why}; rad/s or deg/s cannot be seen at rest: turn by 90 deg and look")  # fmt: skip
    return None


def _of_axis(x: FloatArray, names: Sequence[str], k: int) -> _Guess | None:
    """Return what a column of pairs is by its name; the unit by the norm of the three that go together."""
    for what, pattern in QUANTITIES.items():
        match = pattern.match(names[k])
        if match is None:
            continue
        all_three = [j for j, name in enumerate(names) if pattern.match(name)]
        guess = (
            _vector(x[:, all_three], 0, [names[j] for j in all_three], 0.0) if len(all_three) == 3 else None
        )
        if guess is None:
            return None
        axis = dict(zip("012xyz", "xyzxyz", strict=True))[match[match.lastindex or 0].lower()]
        return _Guess(k, 1, re.sub(r"columns: \[.*\]", f"column: {what}_{axis}", guess.keys), guess.why)
    return None


def _columns(what: str) -> str:
    return f"[{', '.join(f'{what}_{axis}' for axis in 'xyz')}]"


def _about_zero(x: FloatArray) -> bool:
    """Test whether three columns are about zero for numbers with their scatter: noise and a small offset."""
    scatter = x.std(axis=0)
    return bool(
        np.all(scatter > 0) and np.all(np.abs(x.mean(axis=0)) < 30 * scatter.max()) and np.abs(x).max() < 300
    )


def _temperature(x: FloatArray, k: int, name: str) -> _Guess | None:
    near = x.min() >= -40 and x.max() <= 85 and np.ptp(x) < 2
    if NAMED_TEMPERATURE.match(name) and near:
        return _Guess(k, 1, "column: temperature, unit: degC", f"named so, {x.mean():.4g}")
    if not name and near and 10 <= x.mean() <= 60:
        return _Guess(k, 1, "column: temperature, unit: degC", f"{x.mean():.4g} and nearly constant")
    return None

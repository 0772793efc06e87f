"""A device file proposed from lines of text without a description: what the columns may be, and why.

It is a proposal: statistics of a unit at rest separate force from rates, but not deg/s from rad/s.  The
reasons stand beside each field, for somebody to confirm.
"""

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, product
from typing import Any

import numpy as np

from imumon.blocks import FloatArray

from .text import NUMBER, Line

LEAST_LINES = 20  # lines of one kind from which columns are proposed
SAME = 0.8  # share of the lines that must be of one kind: others are headers, comments, torn lines
GRAVITIES = {9.80665: "scale: 1, unit: m/s^2", 1.0: "scale: 1, unit: g", 1000.0: "scale: 1, unit: mg"} | {
    float(counts): f"scale: 1/{counts}, unit: g" for counts in (16384, 8192, 4096, 2048, 256)
}
"""What the norm of the specific force at rest is, in units and counts that are usual."""
NEAR = 0.06  # offset and scale errors of a sensor that is not calibrated: a few percent of gravity
STEADY = 0.05  # relative scatter of a norm, up to which it is that of a constant vector
ZERO = 2.5  # norm, in units of its scatter, up to which three numbers are about zero: of noise it is 2.3
MOST_OFFSET = 30.0  # of a gyro at rest, in standard deviations of its noise; assumed
MOST_RATE = 300.0  # of a gyro at rest, also in raw counts; assumed
SLOWEST, FASTEST = 0.7, 1.4  # rates of a clock, relative to that of the lines; assumed
NORMS = [
    *((g * (1 - NEAR), g * (1 + NEAR), "accel", keys, f"gravity is {g:g}") for g, keys in GRAVITIES.items()),
    *(
        (20.0 * size, 70.0 * size, "mag", f"unit: {unit}", "as the earth's field")
        for unit, size in {"uT": 1.0, "gauss": 0.01, "mgauss": 10.0}.items()
    ),
]
"""Least and largest norm of a constant vector, what it is then, scale and unit, and the reason."""
UNITS = {"us": 1e-6, "ms": 1e-3, "s": 1.0, "ns": 1e-9}
QUANTITIES = {
    "accel": re.compile(r"^(imu[._ ]?)?a(cc(el(eration)?)?)?[._ ]?([xyz012])$", re.I),
    "gyro": re.compile(r"^(imu[._ ]?)?(g(yro?)?|w|omega|rate)[._ ]?([xyz012])$", re.I),
    "mag": re.compile(r"^(imu[._ ]?)?m(ag)?[._ ]?([xyz012])$", re.I),
    "temperature": re.compile(r"^t(emp(erature)?)?([._ ]?(c|degc))?$", re.I),
}

Guess = tuple[str, str, str]
"""Column of a field, empty where it is not known, its other keys, and why."""

_Described = tuple[Mapping[str, Any], Sequence[int | str], Sequence[str]]
"""What lines may be: keys of their description, place or name of each column, and which lines."""


def propose(data: bytes, seconds: float, baudrate: int | None) -> str | None:
    """Return the text of a device file for lines of text; None when there are not enough of one kind.

    `data`: what came within `seconds`, at `baudrate` (bit/s); the first and the last line may be torn.
    """
    lines = [line.strip("\r") for line in data.decode("utf-8", "replace").split("\n")[1:-1]]
    lines = [line for line in lines if line.strip()]
    for keys, places, described in chain(_named(lines), _delimited(lines)):
        numbers = _read(keys, places, described)
        if numbers is not None:
            break
    else:
        return None
    n = len(numbers)
    rate = n / seconds if seconds > 0 else 0.0
    text = [
        "# Proposed from what came; every reason stands beside its line.  Look at it before you trust it.",
        *file_head("lines of text", "text", baudrate, f"{rate:.3g}  # {n} lines in {seconds:.2g} s"),
        "lines:", "  - name: line",
        *(f"    {key}: {json.dumps(value)}" for key, value in keys.items()), "    fields:",
    ]  # fmt: skip
    for place, (column, more, why) in zip(places, _guesses(places, numbers, rate), strict=True):
        at = f"{'at' if isinstance(place, int) else 'key'}: {json.dumps(place)}, column: {column}"
        text += [f"      # {why}", f"      - {{{at}{', ' if more else ''}{more}}}"]
    return "\n".join(text) + "\n"


def file_head(what: str, protocol: str, baudrate: int | None, rate: str) -> list[str]:
    """Return the first lines of a device file, whose reasons stand beside them."""
    return [
        "format: imumon-device/1", "name: proposed", f"title: proposed from {what}",
        'verified: "nothing: proposed from the stream"', f"protocol: {protocol}",
        "axes: FLU  # cannot be determined: x forward, y left, z up, or FRD", f"rate_hz: {rate}",
        f"serial: {{baudrates: [{baudrate or 115_200}]}}",
    ]  # fmt: skip


def _read(keys: Mapping[str, Any], places: Sequence[int | str], lines: Sequence[str]) -> FloatArray | None:
    """Return the numbers of the lines, (n, columns), when nearly all are as they are described."""
    place = "key" if isinstance(places[0], str) else "at"
    fields = [{place: at, "column": f"value_{k}"} for k, at in enumerate(places)]
    line = Line.model_validate({**keys, "name": "line", "fields": fields})
    rows = [numbers for text in lines if (numbers := line.read(text)) is not None]
    return np.array(rows) if len(rows) >= max(LEAST_LINES, SAME * len(lines)) else None


def _named(lines: list[str]) -> Iterator[_Described]:
    """Yield descriptions of lines that name their numbers, as JSON or pairs, by the names that most have."""
    for separator in ("", ",", ";", "\t", " "):
        keys = {"form": "pairs", "separator": separator} if separator else {"form": "json"}
        shapes = Counter(tuple(_names_in(text, separator)) for text in lines)
        del shapes[()]
        for names, _ in shapes.most_common(1):
            yield keys, names, lines


def _names_in(text: str, separator: str) -> list[str]:
    """Return the keys of a line of pairs of key and number, or the paths to the numbers of one of JSON."""
    if not separator:
        try:
            return _leaves(json.loads(text))
        except (ValueError, RecursionError):
            return []
    words = [re.split("[:=]", word, maxsplit=1) for word in text.split(separator)]
    pairs = all(len(word) == 2 and NUMBER.fullmatch(word[1].strip()) for word in words)
    return [word[0].strip() for word in words] if pairs else []


def _leaves(tree: Any, path: str = "") -> list[str]:
    if isinstance(tree, dict | list):
        items = tree.items() if isinstance(tree, dict) else enumerate(tree)
        return [leaf for key, branch in items for leaf in _leaves(branch, f"{path}.{key}".lstrip("."))]
    return [path] if isinstance(tree, int | float) and not isinstance(tree, bool) else []


def _delimited(lines: list[str]) -> Iterator[_Described]:
    """Yield descriptions of lines of words, of which most are numbers."""
    for (prefix, checksum), separator in product(_beginnings(lines), (",", ";", "\t", "|", " ")):
        begun = [x for x in lines if x.startswith(prefix)]
        apart = None if separator == " " else separator
        rows = [(x.rpartition("*")[0] if checksum else x)[len(prefix) :].split(apart) for x in begun]
        size = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
        numbers = [[bool(NUMBER.fullmatch(word.strip())) for word in row] for row in rows if len(row) == size]
        numeric = [k for k in range(size) if sum(row[k] for row in numbers) >= SAME * len(rows)]
        if not numeric or (size == 1 and separator != " "):
            continue
        keys = {"prefix": prefix, "separator": separator, "values": size, "checksum": checksum or "none"}
        yield keys, numeric, begun


def _beginnings(lines: list[str]) -> list[tuple[str, str]]:
    """Return the usual beginnings of lines, none last, and the checksum that ends these lines."""
    found = Counter(re.match(r"[^0-9+\-.]*", text)[0] for text in lines)  # type: ignore[index]  # it may be empty
    usual = [
        begin for begin, n in found.most_common() if n >= max(LEAST_LINES, 0.2 * len(lines)) and begin.strip()
    ]
    starred = sum(bool(re.search(r"\*[0-9A-Fa-f]{2}\s*$", text)) for text in lines) >= SAME * len(lines)
    return [*((begin, "xor8" if starred and begin[0] == "$" else "") for begin in usual), ("", "")]


def _guesses(places: Sequence[int | str], x: FloatArray, rate: float) -> list[Guess]:
    """Return what each column may be."""
    names = [place if isinstance(place, str) else "" for place in places]
    taken = {k: guess for k in range(len(names)) if (guess := _time(x[:, k], rate)) is not None}
    named = [next((what for what, form in QUANTITIES.items() if form.match(name)), "") for name in names]
    # The norm of a temperature and two small numbers may be that of the earth's field: so this comes last.
    for may_be_mag, k in product((False, True), range(len(names) - 2)):
        three = range(k, k + 3)
        if taken.keys() & {*three} or len({*named[k : k + 3]}) > 1:
            continue
        vector = _vector(x[:, three], named[k])
        if vector is not None and (may_be_mag or vector[0] != "mag"):
            what, unit, why = vector
            for j, axis in zip(three, "xyz", strict=True):
                own = names[j][-1:].lower()
                taken[j] = what and f"{what}_{own if own in tuple('xyz') else axis}", unit, why
    return _distinct(names, [taken.get(k) or _single(x[:, k], name) for k, name in enumerate(names)])


def _distinct(names: Sequence[str], guesses: Sequence[Guess]) -> list[Guess]:
    """Return the guesses, of which each column is there once; others have their name or place instead."""
    distinct = dict[str, Guess]()
    for k, (name, (likely, keys, why)) in enumerate(zip(names, guesses, strict=True)):
        plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")
        columns = likely, f"{plain}_raw" if plain[:1].isalpha() else "", f"value_{k}"
        column = next(one for one in columns if one and one not in distinct)
        if likely and column != likely:
            keys, why = "", f"also looks like {likely} ({why}), only one can be"
        distinct[column] = column, keys, why
    return [*distinct.values()]


def _time(x: FloatArray, rate: float) -> Guess | None:
    """Return what a column is that rises, as time does or by one a line."""
    step = np.diff(x)
    middle = float(np.median(step))
    if middle <= 0 or np.mean(step > 0) < SAME:
        return None
    whole = bool(np.all(x == np.rint(x))) and x.min() >= 0 and x.max() < 1 << 32
    for unit, size in UNITS.items():
        if SLOWEST < middle * size * rate < FASTEST:
            why = f"rises by {middle:.6g} a line: at {rate:.4g} lines a second that is {unit}"
            return "device_ticks", f"{'type: u32, ' if whole else ''}unit: {unit}", why
    return ("packet_counter", "type: u32", "rises by one a line") if whole and middle == 1.0 else None


def _vector(x: FloatArray, named: str) -> Guess | None:
    """Return quantity, scale and unit, and the reason, of three columns; None when it is not known.

    `named`: what their names say; may be empty.  The quantity is empty where the unit moved.
    """
    low, norm, high = np.percentile(np.linalg.norm(x, axis=1), (16, 50, 84))  # a few shocks do not count
    scatter = (high - low) / 2
    how = f"{'named so; ' if named else ''}norm {norm:.4g} with scatter {scatter:.2g}"
    for least, most, what, keys, why in NORMS if scatter < STEADY * norm else ():
        if least <= norm <= most and named in ("", what):
            return what, keys, f"{how}: {why}"
    # Numbers with their scatter: noise and a small offset.  A filter correlates a few lines, a hand more.
    later = 1 + len(x) // 20
    deviation, offset = x.std(axis=0), np.abs(x.mean(axis=0))
    is_noise = np.all(deviation > 0) and np.all(offset < MOST_OFFSET * deviation.max())
    is_small = is_noise and np.abs(x).max() < MOST_RATE
    if named == "gyro" or (not named and is_small):
        if named:
            why = "named so"
        elif norm < ZERO * scatter:
            why = "about zero on all three axes"
        elif (x[later:] - x[:-later]).var(axis=0).sum() > (deviation**2).sum():  # twice if white
            why = f"{how}: noise about a bias"
        else:
            return "", "", f"{how}, changing slowly: the unit moved; keep it at rest while detecting"
        return "gyro", "unit: deg/s", f"{why}; rad/s or deg/s is not known at rest: turn by 90 deg and look"
    return None


def _single(x: FloatArray, name: str) -> Guess:
    """Return what a column is taken for that belongs to no other."""
    steady = x.min() >= -40 and x.max() <= 85 and np.ptp(x) < 2
    if steady and (QUANTITIES["temperature"].match(name) or (not name and 10 <= x.mean() <= 60)):
        why = "named so" if name else "nearly constant"
        return "temperature", "unit: degC", f"{why}, {x.mean():.4g}"
    return "", "", "its meaning is unknown"

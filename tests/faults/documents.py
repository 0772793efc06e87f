"""YAML files that attack their loaders: each must be refused in one clear line, at once."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

from imumon.config import load_yaml
from imumon.errors import ImumonError, Reason
from imumon.fleet.rack.description import load_rack
from imumon.models.model import load_model
from imumon.protocols.device import device_text, load_device
from imumon.recordings.folder import read_metadata
from imumon.recordings.importing import TableImport
from imumon.run.setup import Noise, load_setup
from imumon.simulation.unit import load_scenario
from tests.faults.rows import Row

LONGEST_S = 2.0
"""On a busy machine."""


def _bomb() -> str:
    lines = ["a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"{chr(98 + n)}: &{chr(98 + n)} [{', '.join([f'*{chr(97 + n)}'] * 9)}]" for n in range(9)]
    return "\n".join(lines)


DOCUMENTS: dict[str, str] = {
    "contains itself": "format: &a [*a]",
    "a mapping that contains itself": "format: &a {b: *a}",
    "aliases that grow to 4e9 values": _bomb(),
    "100,000 brackets": "format: " + "[" * 100_000,
    "100,000 mappings": "{a: " * 100_000,
    "1e400": "format: x\nlatitude_deg: 1e400",
    "10^19": "format: x\nlatitude_deg: 10000000000000000000",
    "not a number": "format: x\nlatitude_deg: .nan",
    "infinity": "format: x\nlatitude_deg: -.inf",
    "an integer of 5000 digits": "format: x\nlatitude_deg: " + "9" * 5000,
    "base sixty with 3000 digits": "format: x\nlatitude_deg: 1" + ":59" * 3000 + ".5",
    "a Python object": "format: !!python/object/apply:os.system [true]",
    "5 MB in one line": "format: " + "x" * 5_000_000,
    "a control character": "format: \x07",
    "nothing": "",
}


def _map(path: Path) -> object:
    table = path.with_name("table.csv")
    table.write_text("t,gx\n0,1\n")
    return TableImport(table, path)


LOADERS: dict[str, Callable[[Path], object]] = {
    "session": read_metadata,
    "device": lambda path: load_device(str(path)),
    "pipeline": load_setup,
    "model": load_model,
    "map": _map,
    "noise": lambda path: load_yaml(path, Noise),
    "scenario": load_scenario,
    "rack": load_rack,
}


def device_with(old: str, new: str) -> str:
    """Return the file of a device that is known, changed at one place."""
    text = device_text("ax1")[0]
    assert old in text, old
    return text.replace(old, new, 1)


def refused(load: Callable[[], object]) -> str:
    """Return why something was refused; "" when it was taken, and another line for anything wrong."""
    began = time.process_time()
    try:
        load()
    except ImumonError as error:
        took = time.process_time() - began
        if took > LONGEST_S:
            return f"wrong: refused after {took:.1f} s"
        if error.reason not in (Reason.BAD_CONFIG, Reason.BAD_DATA):
            return f"wrong: {error.reason}"
        return error.seen
    return ""


def attack_all(folder: Path) -> Iterator[Row]:
    """Give each document to each loader."""
    for kind, load in LOADERS.items():
        path = folder / f"{kind}.yaml"
        bad = []
        for name, text in DOCUMENTS.items():
            path.write_text(text, encoding="utf-8")
            said = refused(lambda load=load, path=path: load(path))  # type: ignore[misc]  # bound at once
            if not said or said.startswith("wrong") or ("\n" in said.strip() and len(said) > 2000):
                bad.append(f"{name}: {said or 'taken'}")
        yield Row(
            f"hostile {kind} file",
            len(DOCUMENTS),
            "; ".join(bad) or "each refused with a message",
            held=not bad,
        )

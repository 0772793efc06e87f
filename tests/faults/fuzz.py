"""Changed files and streams for every reader: refused with a message, or read; never another exception."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from imumon.blocks import SampleBlock
from imumon.columns import KNOWN
from imumon.config import dump_yaml
from imumon.errors import ImumonError
from imumon.pipeline import Pipeline
from imumon.protocols.device import device_names, device_text, load_device
from imumon.recordings.folder import METADATA_NAME, WIRE_NAME, SessionMetadata
from imumon.recordings.importing import import_table
from imumon.recordings.source import open_recording, open_source, run_over
from imumon.recordings.table import TableWriter, read_table
from imumon.recordings.wire import WireWriter
from imumon.transport.reader import Bytes, Event, EventKind
from tests.faults.cost import sample_packet
from tests.faults.documents import LOADERS
from tests.faults.rows import Row
from tests.models.models import three_curves

MAP = """time: {column: t, unit: s}
gyro: {columns: [gx, gy, gz], unit: deg/s}
temperature: {columns: [temp], unit: degC}
"""
TOKENS = [
    b"1e400",
    b".nan",
    b"-.inf",
    b"99999999999999999999",
    b"[",
    b"{",
    b"&a",
    b"*a",
    b"!!int",
    b"\0",
    b"~",
]
TOKENS += [
    b"\xff\xfe",
    b"\xef\xbb\xbf",
    b'"',
    b"'",
    b",,,,",
    b"\r",
    b"\n\n",
    b"\t",
    b"1/0",
    b"deg^9",
    b"-1",
    b"0",
]
TOKENS += [b"\x00\x00\x00\x00", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"../../x", b": ", b"- ", b"\xc3"]
SLOWEST_S = 5.0
JOINED = 64
"""Changed packets in a stream that one decoder is given: it goes on from one to the next, as on a line."""
Edit = tuple[float, int, bytes]
"""Where, as a part of the length, how many bytes go, and which come."""


@dataclass(frozen=True, slots=True)
class Target:
    """Something that reads: what it reads when all is well, and how it is given data.

    Parameters
    ----------
    seed : bytes
    read : callable
        Takes data and an empty folder.
    """

    seed: bytes
    read: Callable[[bytes, Path], object]


def _loader(load: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    def read(data: bytes, folder: Path) -> object:
        path = folder / "file.yaml"
        path.write_bytes(data)
        return load(path)

    return read


def _decode(name: str) -> Callable[[bytes, Path], object]:
    device = load_device(name)

    def read(data: bytes, _: Path) -> object:
        decoder = device.decoder()
        decoder.feed(data, 1)
        decoder.finish()
        decoder.take_packets()
        books = decoder.counters()
        assert books.bytes_in_packets + books.bytes_skipped + books.bytes_pending == len(data)
        return decoder.notices(), decoder.warnings()

    return read


def _device(data: bytes, folder: Path) -> object:
    """Load a device file; one that is taken makes a decoder that decodes."""
    path = folder / "file.yaml"
    path.write_bytes(data)
    decoder = load_device(str(path)).decoder()
    decoder.feed(bytes(200), 0)
    return decoder.counters()


def _session(name: str, other: bytes) -> Callable[[bytes, Path], object]:
    """Open and run a session of which one file is changed; `other` is the one that is not."""

    def read(data: bytes, folder: Path) -> object:
        for each in (METADATA_NAME, WIRE_NAME):
            (folder / each).write_bytes(data if each == name else other)
        source = open_source(folder)
        pipeline = Pipeline(source.device)
        for _ in run_over(source.items, pipeline):
            pass
        return source.warnings(), source.losses()

    return read


def _import(suffix: str) -> Callable[[bytes, Path], object]:
    def read(data: bytes, folder: Path) -> object:
        (folder / "map.yaml").write_text(MAP)
        table = folder / f"table{suffix}"
        table.write_bytes(data)
        return import_table(table, folder / "map.yaml", folder / "out")

    return read


def _table(suffix: str) -> Callable[[bytes, Path], object]:
    def read(data: bytes, folder: Path) -> object:
        table = folder / f"table{suffix}"
        table.write_bytes(data)
        for _ in open_recording(table).blocks():
            pass
        return read_table(table)

    return read


def _made_tables() -> dict[str, bytes]:
    """Return a table as imumon writes it, by suffix."""
    n = 50
    names = ("device_time_ns", "segment", "gyro_x", "gyro_y", "gyro_z", "temperature")
    block = SampleBlock({name: np.arange(n).astype(KNOWN[name].dtype) for name in names})
    made = {}
    with TemporaryDirectory() as folder:
        for suffix in (".csv", ".parquet"):
            path = Path(folder) / f"t{suffix}"
            with TableWriter(path, {name: KNOWN[name] for name in names}) as writer:
                writer.write(block)
            made[suffix] = path.read_bytes()
    return made


def _wire() -> bytes:
    packet = sample_packet(load_device("ax1"))
    with TemporaryDirectory() as folder:
        writer = WireWriter(Path(folder) / WIRE_NAME, {})
        writer.write(Event(EventKind.OPENED, 1, "open"))
        for number in range(30):
            writer.write(Bytes(packet, 10**18 + number * 10**7))
            writer.flush()
        writer.close()
        return (Path(folder) / WIRE_NAME).read_bytes()


DOCUMENTS = {
    "pipeline": "format: imumon-pipeline/1\nlatitude_deg: 48.0\n",
    "model": three_curves().to_yaml(),
    "map": MAP,
    "rack": "format: imumon-rack/1\ndefault: {device: ax1}\nunits: {one: {port: /tmp/one, baud: 115200}}\n",
    "noise": "gyro: {angle_random_walk_rad_per_sqrt_s: [1.0e-4, 1.0e-4, 2.0e-4]}\n",
    "scenario": (Path(__file__).parents[2] / "configs" / "scenarios" / "bench.yaml").read_text(
        encoding="utf-8"
    ),
}


def targets() -> dict[str, Target]:
    """Return everything that reads."""
    metadata = SessionMetadata.begun("live", 1, device="ax1", device_yaml=device_text("ax1")[0])
    session, wire = dump_yaml(metadata.model_dump()).encode(), _wire()
    texts = {kind: text.encode() for kind, text in DOCUMENTS.items()}
    texts |= {"session": session, "device": device_text("ax1")[0].encode()}
    found = {kind: Target(texts[kind], _loader(load)) for kind, load in LOADERS.items()}
    found["device"] = Target(texts["device"], _device)
    found["session folder, session.yaml"] = Target(session, _session(METADATA_NAME, wire))
    found["session folder, wire.mcap"] = Target(wire, _session(WIRE_NAME, session))
    csv = b"t,gx,gy,gz,temp\n" + b"".join(b"%d.5,1,2,3,25.0\n" % n for n in range(30))
    found["import of a .csv"] = Target(csv, _import(".csv"))
    made = _made_tables()
    for suffix, data in made.items():
        found[f"table {suffix}"] = Target(data, _table(suffix))
    columns = {name: np.arange(30.0) for name in ("t", "gx", "gy", "gz", "temp")}
    sink = BytesIO()
    pq.write_table(pa.table(columns), sink)
    found["import of a .parquet"] = Target(sink.getvalue(), _import(".parquet"))
    for name in device_names():
        found[f"decoder {name}"] = Target(sample_packet(load_device(name)) * 8, _decode(name))
    return found


def attempt(target: Target, data: bytes) -> str:
    """Give a target data; return what went wrong, "" for nothing."""
    with TemporaryDirectory() as folder:
        return _said(target, data, Path(folder))


def _said(target: Target, data: bytes, folder: Path) -> str:
    began = time.process_time()
    try:
        target.read(data, folder)
    except ImumonError:
        pass
    except Exception as error:  # noqa: BLE001 - any other is what is looked for
        return f"{type(error).__name__}: {error}"
    took = time.process_time() - began
    return f"took {took:.1f} s" if took > SLOWEST_S else ""


def edited(data: bytes, edits: Sequence[Edit]) -> bytes:
    """Return data with bytes at some places replaced."""
    changed = bytearray(data)
    for where, removed, put in edits:
        at = int(where * len(changed))
        changed[at : at + removed] = put
    return bytes(changed)


def mutate(data: bytes, rng: Random) -> bytes:
    """Return data changed at a few places, and sometimes cut."""
    edits: list[Edit] = []
    for _ in range(rng.randrange(1, 5)):
        kind, length = rng.randrange(3), rng.randrange(12)
        if kind == 0:
            put = rng.choice(TOKENS)
        elif kind == 1:
            at = rng.randrange(len(data))
            put = data[at : at + length]
        else:
            put = rng.randbytes(length)
        removed = len(data) if rng.random() < 0.03 else rng.randrange(12)
        edits.append((rng.random(), removed, put))
    return edited(data, edits)


def fuzz_all(times: int, seed: int, names: Sequence[str] | None = None) -> Iterator[Row]:
    """Give each target so many changed inputs."""
    every = targets()
    for name in names or every:
        target, rng, wrong = every[name], Random(seed), dict[str, bytes]()
        sound = attempt(target, target.seed)
        for _ in range(times):
            data = mutate(target.seed, rng)
            if said := attempt(target, data):
                wrong.setdefault(said[:120], data)
        found = [f"{said} ({data[:200]!r})" for said, data in wrong.items()]
        outcome = (
            "; ".join([*([f"the seed: {sound}"] if sound else []), *found])
            or "each refused with a message, or read"
        )
        yield Row(f"changed {name}", times, outcome, held=not wrong and not sound)


def stream_all(times: int, seed: int, names: Sequence[str] | None = None) -> Iterator[Row]:
    """Give each decoder so many changed inputs, one after the other in streams of `JOINED`."""
    for name in names or device_names():
        target, rng = Target(sample_packet(load_device(name)) * 8, _decode(name)), Random(seed)
        attempt(target, target.seed)  # compiles what must be
        wrong, began = dict[str, bytes](), time.process_time()
        for _ in range(-(-times // JOINED)):
            data = b"".join(mutate(target.seed, rng) for _ in range(JOINED))
            if said := _said(target, data, Path()):
                wrong.setdefault(said[:120], data)
        rate = times / (time.process_time() - began)
        found = [f"{said} ({data[:200]!r} ...)" for said, data in wrong.items()]
        outcome = "; ".join(found) or f"every byte accounted for; {rate:,.0f} a second of processor time"
        yield Row(f"changed streams for {name}", times, outcome, held=not wrong)

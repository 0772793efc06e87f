"""A scenario as a session or as a table, as fast as it can be computed."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from imumon.blocks import IntArray
from imumon.columns import KNOWN, Column
from imumon.files import write_text
from imumon.protocols.device import DeviceFile
from imumon.recordings.folder import (
    TRUTH_NAME,
    PortUsed,
    Session,
    SessionMetadata,
    create_session,
    whole_session,
)
from imumon.recordings.table import TableWriter
from imumon.recordings.wire import WireWriter
from imumon.transport.reader import Bytes, Event, EventKind

from .unit import TRUTH_COLUMNS, Scenario, SimulatedUnit
from .unit.noise import generator
from .unit.thermal import chamber_log
from .unit.unit import CHUNK
from .virtual_device import refuse_overload, switch_on
from .virtual_port import BITS_PER_BYTE

SCENARIO_NAME = "scenario.yaml"
CHAMBER_NAME = "chamber.csv"
START_NS = 1_767_225_600_000_000_000
"""Unix time at which simulated units are switched on, 2026-01-01: the same seed gives the same session."""
LATENCY_NS = 1_000_000
"""An adapter in low-latency mode hands over what has come every millisecond."""
WAKE_UP_NS = 100_000.0
"""Mean time until the reader wakes up and has read."""

Progress = Callable[[int], object]
"""Called with the number of samples that are done since it was last called."""


def record_session(
    scenario: Scenario, device: DeviceFile, device_yaml: str, seed: int, folder: Path, progress: Progress
) -> Session:
    """Make a session of a scenario: the packets that the device sends, and beside them the truth.

    The truth is in truth.parquet, one row a packet, the scenario as it was played in scenario.yaml, and the
    log of the chamber, where there is one, in chamber.csv; all are ignored by whatever reads the session.

    Raises EXISTS when there is a session already; BAD_CONFIG when the packets do not fit through the line;
    BAD_DATA when a value does not fit its field; OSError when the disk is full or fails; nothing is left
    behind.
    """
    refuse_overload(device, scenario)
    text = yaml.safe_dump(scenario.model_dump(exclude_defaults=True), sort_keys=False, allow_unicode=True)
    with whole_session(folder) as partial:
        metadata = SessionMetadata.begun(
            "simulation",
            START_NS,
            device=device.name,
            axes=device.axes,
            device_yaml=device_yaml,
            port=PortUsed(
                url=f"simulation: {scenario.title}",
                settings={"seed": seed, "rate_hz": scenario.rate_hz, "duration_s": scenario.duration_s},
            ),
        )
        session = create_session(partial, metadata)
        write_text(partial / SCENARIO_NAME, text)
        if scenario.chamber.log is not None:
            rows, heads = np.column_stack(chamber_log(scenario, seed)), "time_s,wall_degc,case_degc"
            np.savetxt(partial / CHAMBER_NAME, rows, fmt="%.3f", delimiter=",", header=heads, comments="")
        encoder, arrivals = device.encoder(), _Arrivals(device.serial.baudrates[0], seed)
        unit = switch_on(device, scenario, seed)
        names = [KNOWN["device_time_ns"], KNOWN["segment"], *TRUTH_COLUMNS]
        with (
            closing(WireWriter(session.wire_path, metadata.for_wire())) as writer,
            TableWriter(partial / TRUTH_NAME, {column.name: column for column in names}) as table,
        ):
            writer.write(Event(EventKind.OPENED, START_NS, f"simulation, seed {seed}"))
            for size in _sizes(scenario):
                sent, truth = unit.run(size)
                since_ns = np.rint(sent["packet_counter"] * (1e9 / scenario.rate_hz)).astype(np.int64)
                for read in arrivals.reads(encoder.encode(sent), START_NS + since_ns):
                    writer.write(read)
                writer.flush()
                table.write(truth)
                progress(size)
            writer.write(Event(EventKind.CLOSED, arrivals.last_ns, "the end of the scenario"))
        made, n = writer.counters, scenario.samples
        closed = metadata.closed(
            START_NS + round(n / scenario.rate_hz * 1e9),
            counters={"samples": n, "packets": n, "bytes_received": made.bytes},
            events=made.events,
        )
        session.save(closed)
    return Session(folder, closed)


def write_table(scenario: Scenario, seed: int, path: Path, progress: Progress) -> None:
    """Write a scenario to one table, the truth in columns that begin with true_.

    Raises BAD_CONFIG for a suffix that is neither .parquet nor .csv, or when the folder does not exist;
    OSError when the disk is full or fails; a file that was there before is untouched.
    """
    unit = SimulatedUnit(scenario, seed)
    known = {
        **{name: Column(name, course.unit) for name, course in scenario.drivers.items()},
        **KNOWN,
        "supply_voltage": Column("supply_voltage", "V"),
        **{f"true_{c.name}": replace(c, name=f"true_{c.name}") for c in TRUTH_COLUMNS},
    }
    with TableWriter(path, {}) as writer:
        for size in _sizes(scenario):
            sent, truth = unit.run(size)
            rows = sent.with_columns({f"true_{c.name}": truth[c.name] for c in TRUTH_COLUMNS})
            writer.announce([known[name] for name in rows.columns])
            writer.write(rows)
            progress(size)


def _sizes(scenario: Scenario) -> Iterator[int]:
    for first in range(0, scenario.samples, CHUNK):
        yield min(CHUNK, scenario.samples - first)


class _Arrivals:
    """When a host reads the packets: after the line, the adapter and the reader, each with its delay."""

    def __init__(self, baudrate: int, seed: int) -> None:
        self._byte_ns = BITS_PER_BYTE * 1e9 / baudrate
        self._random = generator(seed, "arrival")
        self.last_ns = START_NS

    def reads(self, packets: list[bytes], time_ns: IntArray) -> Iterator[Bytes]:
        """Yield what is read at once, in order; `time_ns` is the Unix time of each packet's sample, (n,)."""
        on_line = np.array([len(packet) for packet in packets]) * self._byte_ns
        slot = -(-(time_ns + on_line.astype(np.int64)) // LATENCY_NS)
        late = self._random.exponential(WAKE_UP_NS, len(packets)).astype(np.int64)
        begins = np.flatnonzero(np.diff(slot, prepend=-1))
        arrival = np.maximum.accumulate(np.maximum(slot[begins] * LATENCY_NS + late[begins], self.last_ns))
        ends = [*begins[1:], len(packets)]
        for begin, end, arrival_ns in zip(begins.tolist(), ends, arrival.tolist(), strict=True):
            yield Bytes(b"".join(packets[begin:end]), arrival_ns)
        self.last_ns = int(arrival[-1])

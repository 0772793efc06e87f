"""A device on a line that can be made to fail: what a live run makes of it, and what it should.

The line is the virtual port: it has a speed, a cable that can be pulled, and an adapter that holds bytes
back.  Each fault says of every packet whether it got through whole, so that what was accepted can be compared
with what was sent: no bad packet accepted, no good one lost, every byte accounted for.
"""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from unittest.mock import patch

import numpy as np

from imumon.blocks import SampleBlock, join
from imumon.pipeline import Digest, Pipeline
from imumon.protocols.device import device_text, load_device
from imumon.recordings.folder import open_session
from imumon.recordings.source import run_over
from imumon.recordings.wire_reader import WireReader
from imumon.run.live import LiveRun, warm_up
from imumon.run.setup import Setup
from imumon.run.stages import estimators
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.unit.unit import MICROSECOND
from imumon.simulation.virtual_port import CHUNK_S
from imumon.transport.reader import Event, EventKind
from imumon.transport.settings import PortSettings
from imumon.view.items import State, ViewItem
from tests.faults.port import FaultyPort
from tests.faults.rows import Row
from tests.waiting import unread, wait_until

DEVICE = load_device("ax1")
RATE_HZ = 150.0
"""Three quarters of the line."""
PROMISED_S = 1.0
"""From the moment the line is good again to the first packet that is decoded."""
HEALTHY_S = 1.2
"""After each fault; half of it before."""
FAULT_S = 0.6
UNSURE_PACKETS = 12
"""Packets that may be in the buffers of a cable that is pulled: 80 ms."""
COUNTER_RANGE, TICK_RANGE = 1 << 16, 1 << 32

Packets = list[bytes]
Mangle = Callable[[Packets, np.random.Generator], tuple[Packets, Packets]]
"""Takes packets that are sent at once; returns what is put on the line, and which packets are whole in it."""


class Line:
    """Packets of a simulated unit on their way to a live run, each noted with what must become of it."""

    def __init__(self, link: Path, seed: int) -> None:
        self.port = FaultyPort(link, DEVICE.serial.baudrates[0])
        self.rng = np.random.default_rng(seed)
        self.sure: Counter[bytes] = Counter()
        """Packets that must be accepted, as often as here."""
        self.unsure: Counter[bytes] = Counter()
        """Packets that may be accepted: under way when the cable was pulled, or no host listened."""
        self.stolen = 0
        self.spoiled = False
        """Whether the host cannot have read the bytes that were sent."""
        self.boots = 0
        self.counter_at = self.tick_at = 0
        self._encoder = DEVICE.encoder()
        self.boot(seed)

    def boot(self, seed: int = 1) -> None:
        """Switch the device on: its counter and clock begin at zero."""
        tick_ns = DEVICE.decoder().timing.tick_ns or MICROSECOND
        scenario = load_scenario("bench").played(RATE_HZ, DEVICE.axes)
        self._unit = SimulatedUnit(scenario, self.boots + 100 * seed, tick_ns)
        self.counter_at = self.tick_at = 0
        self.boots += 1

    def packets(self, n: int) -> Packets:
        """Return the next packets of the device."""
        block = self._unit.samples(n)
        counter = (block["packet_counter"] + self.counter_at) % COUNTER_RANGE
        ticks = (block["device_ticks"] + self.tick_at) % TICK_RANGE
        return self._encoder.encode(block.with_columns({"packet_counter": counter, "device_ticks": ticks}))

    def send(self, seconds: float, mangle: Mangle | None = None, burst: int = 1) -> None:
        """Send in real time, in bursts of so many packets, each changed on its way."""
        began, sent = time.monotonic(), 0
        while sent < seconds * RATE_HZ:
            packets = self.packets(burst)
            sent += burst
            on_line, whole = (packets, packets) if mangle is None else mangle(packets, self.rng)
            listening = self.port.host_listens()
            self.port.write(b"".join(on_line))
            (self.sure if listening else self.unsure).update(whole)
            time.sleep(max(0.0, began + sent / RATE_HZ - time.monotonic()))

    def pull(self) -> None:
        """Pull the cable in the middle of a packet, with bytes on their way."""
        packets = self.packets(UNSURE_PACKETS)
        self.port.write(b"".join(packets)[:-30])
        self.unsure.update(packets)
        self.port.unplug()

    def settle(self) -> None:
        """Let everything arrive, and be read where a host listens."""
        self.port.drain()
        if self.port.host_listens():
            slave = os.open(self.port.path, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
            try:
                wait_until(lambda: not unread(slave))
            finally:
                os.close(slave)
        time.sleep(0.1)

    def close(self) -> None:
        """Close the port."""
        self.port.close()


def flip_bits(packets: Packets, rng: np.random.Generator) -> tuple[Packets, Packets]:
    """Flip one bit of every third packet."""
    on_line, whole = [], []
    for packet in packets:
        changed = bytearray(packet)
        if rng.random() < 0.3:
            changed[int(rng.integers(len(packet)))] ^= 1 << int(rng.integers(8))
        else:
            whole.append(packet)
        on_line.append(bytes(changed))
    return on_line, whole


def cut(packets: Packets, rng: np.random.Generator) -> tuple[Packets, Packets]:
    """Lose some bytes of every third packet."""
    on_line, whole = [], []
    for packet in packets:
        start, size = int(rng.integers(len(packet))), int(rng.integers(1, 30))
        hit = rng.random() < 0.3
        on_line.append(packet[:start] + packet[start + size :] if hit else packet)
        whole += [] if hit else [packet]
    return on_line, whole


def junk(packets: Packets, rng: np.random.Generator) -> tuple[Packets, Packets]:
    """Put noise, and heads that promise a packet, between the packets."""
    lures = (b"\xa5\x5a", b"\xa5\x5a\x3a", b"\xa5", rng.bytes(int(rng.integers(1, 12))))
    return [lures[int(rng.integers(len(lures)))] + packet for packet in packets], packets


def duplicate(packets: Packets, _: np.random.Generator) -> tuple[Packets, Packets]:
    """Send a burst twice."""
    return packets + packets, packets + packets


def reorder(packets: Packets, rng: np.random.Generator) -> tuple[Packets, Packets]:
    """Shuffle the packets of a burst."""
    order = rng.permutation(len(packets))
    return [packets[n] for n in order], packets


@dataclass(frozen=True, slots=True)
class LineFault:
    """What is done to the line for a while, and what must be said of it."""

    strike: Callable[[Line], None]
    restarts: int | None = 0
    """New segments; None: not fixed."""
    port: Sequence[str] = ()
    """States that the lane of the port must go through."""
    data: str = ""
    """State that the lane of the data must have shown."""


def _mangled(mangle: Mangle, burst: int = 1) -> Callable[[Line], None]:
    return lambda line: line.send(FAULT_S, mangle, burst)


def _held(seconds: float, for_s: float) -> Callable[[Line], None]:
    def strike(line: Line) -> None:
        line.port.held_s = seconds
        line.send(for_s)
        line.port.held_s = CHUNK_S

    return strike


def _wrong_baud(line: Line) -> None:
    line.settle()
    line.spoiled = True
    line.port.baudrate = 57600
    spoilt = b"".join(line.packets(round(RATE_HZ * FAULT_S / 2)))
    line.port.write(spoilt)
    line.settle()
    line.port.baudrate = DEVICE.serial.baudrates[0]


def _silent(line: Line) -> None:
    line.settle()
    line.port.silence()
    line.packets(round(1.4 * RATE_HZ))
    time.sleep(1.4)
    line.port.resume()


def _unplugged(away_s: float, *, abrupt: bool) -> Callable[[Line], None]:
    def strike(line: Line) -> None:
        if abrupt:
            line.pull()
        else:
            line.settle()
            line.port.unplug()
        line.packets(round(away_s * RATE_HZ))
        time.sleep(away_s)
        line.port.replug()

    return strike


def _reboot(line: Line) -> None:
    line.send(0.1)
    packet = line.packets(1)[0]
    line.port.write(packet[: len(packet) // 2])
    time.sleep(0.3)
    line.boot()


def _wrap(line: Line) -> None:
    """The counter is about to wrap, as after seven minutes, and the clock, as after 71 minutes: a jump."""
    line.boot()
    line.counter_at, line.tick_at = COUNTER_RANGE - 40, TICK_RANGE - 300_000
    line.send(FAULT_S)


def _device_clock(by_s: float) -> Callable[[Line], None]:
    def strike(line: Line) -> None:
        line.tick_at += round(by_s * 1e6)
        line.send(FAULT_S)

    return strike


def _host_clock(by_s: float) -> Callable[[Line], None]:
    def strike(line: Line) -> None:
        real = time.time_ns
        with patch("time.time_ns", lambda: real() + round(by_s * 1e9)):
            line.send(FAULT_S)

    return strike


FAULTS: dict[str, LineFault] = {
    "nothing": LineFault(lambda line: line.send(FAULT_S)),
    "bits flipped in every third packet": LineFault(_mangled(flip_bits), data="warning: losses"),
    "bytes lost from every third packet": LineFault(_mangled(cut), data="warning: losses"),
    "junk before every packet": LineFault(_mangled(junk), data="warning: losses"),
    "packets sent twice, in pairs": LineFault(_mangled(duplicate, 2), restarts=None),
    "packets of a burst of 5 shuffled": LineFault(_mangled(reorder, 5), restarts=None),
    "adapter holds bytes for 16 ms": LineFault(_held(0.016, FAULT_S)),
    "stall of 0.7 s, then all at once": LineFault(_held(0.7, 0.7)),
    "wrong baud rate": LineFault(_wrong_baud),
    "device silent for 1.4 s": LineFault(_silent, port=("silent", "open")),
    "cable pulled between packets": LineFault(_unplugged(0.3, abrupt=False), port=("lost", "open")),
    "cable pulled in a packet": LineFault(_unplugged(0.3, abrupt=True), port=("lost", "open")),
    "cable pulled for 3 s": LineFault(_unplugged(3.0, abrupt=True), port=("lost", "open")),
    "device reboots in a packet": LineFault(_reboot, restarts=1),
    "counter and clock wrap (after a reboot)": LineFault(_wrap, restarts=1),
    "device clock leaps an hour ahead": LineFault(_device_clock(3600.0), restarts=1),
    "device clock leaps a minute back": LineFault(_device_clock(-60.0), restarts=1),
    "host clock leaps an hour ahead": LineFault(_host_clock(3600.0)),
    "host clock leaps an hour back": LineFault(_host_clock(-3600.0)),
}


@dataclass(slots=True)
class Outcome:
    """What did not go as it should, and how long it took to recover."""

    recovered_s: float = 0.0
    wrong: list[str] = field(default_factory=list)


class Watched:
    """A live run, and what it shows."""

    def __init__(self, line: Line, folder: Path) -> None:
        self.line, self.folder = line, folder
        self.items: list[ViewItem] = []
        self.said: list[str] = []
        text, settings = device_text(DEVICE.name)[0], PortSettings(line.port.path, line.port.baudrate)
        self.run = LiveRun(DEVICE, text, settings, Setup(), folder, lambda _, text: self.said.append(text))
        self.run.open()
        self.run.begin([self.items.append])

    def states(self, lane: str, since: int) -> list[str]:
        """Return the state that a lane had at an item, and those that it went through since."""
        every = [(n, s.state) for n, s in enumerate(self.items) if isinstance(s, State) and s.lane == lane]
        before = [state for n, state in every if n < since][-1:]
        return before + [state for n, state in every if n >= since]

    def rows(self, since: int = 0) -> SampleBlock:
        """Return the samples that were shown."""
        return join([item.block for item in self.items[since:] if hasattr(item, "block")])

    def strike(
        self, fault: LineFault, healthy_s: float = HEALTHY_S, promised_s: float = PROMISED_S
    ) -> Outcome:
        """Let one fault happen between two healthy stretches."""
        line, outcome = self.line, Outcome()
        line.send(healthy_s / 2)
        line.settle()
        before, since = self.run.pipeline.counters, len(self.items)
        fault.strike(line)
        good, at = time.time_ns(), len(self.items)
        line.send(healthy_s)
        line.settle()
        wait_until(lambda: self._recovered_s(at, good) < np.inf)
        outcome.recovered_s = self._recovered_s(at, good)
        if outcome.recovered_s > promised_s:
            outcome.wrong.append(f"first packet after {outcome.recovered_s:.2f} s")
        after = self.run.pipeline.counters
        restarts = after.clock_restarts - before.clock_restarts
        if fault.restarts is not None and restarts != fault.restarts:
            outcome.wrong.append(f"{restarts} restarts were counted, {fault.restarts} happened")
        port = self.states("port", since)
        if port != ["open", *fault.port]:
            outcome.wrong.append(f"lane of the port: {port}")
        if fault.data and not wait_until(lambda: fault.data in self.states("data", since)):
            outcome.wrong.append(f"lane of the data: {self.states('data', since)}")
        rate = self.run.progress.packets_per_s
        if not 0.1 * RATE_HZ < rate < 2.1 * RATE_HZ:
            outcome.wrong.append(f"{rate:.0f} packets/s are shown, {RATE_HZ:g} are sent")
        return outcome

    def _recovered_s(self, since: int, good_ns: int) -> float:
        """Return how long after a time the first packet was read; infinite while none was."""
        rows = self.rows(since)
        if not len(rows):
            return np.inf
        arrivals = rows["arrival_time_ns"]
        later = arrivals[arrivals >= good_ns]
        return float(later[0] - good_ns) * 1e-9 if len(later) else np.inf

    def finish(self) -> list[str]:
        """Stop, and compare what was accepted with what was sent, and the recording with the run."""
        line, wrong = self.line, []
        summary = self.run.stop()
        counters, wire = summary.counters, summary.wire
        books = counters.bytes_in_packets + counters.bytes_skipped + counters.bytes_pending
        if books != counters.bytes_received or counters.bytes_pending:
            wrong.append(f"of {counters.bytes_received} bytes {books} are accounted for")
        if wire.bytes_on_disk != counters.bytes_received:
            wrong.append(f"{wire.bytes_on_disk} of {counters.bytes_received} bytes are recorded")
        if (
            not line.spoiled
            and not line.unsure
            and counters.bytes_received + line.stolen != line.port.bytes_sent
        ):
            wrong.append(f"{counters.bytes_received} of {line.port.bytes_sent} bytes were read")
        accepted = Counter(packets_of(self.rows()))
        wanted, allowed = as_rows(line.sure), as_rows(line.unsure)
        if bad := accepted - wanted - allowed:
            wrong.append(f"{bad.total()} packets accepted that were not sent")
        if lost := wanted - accepted:
            wrong.append(f"{lost.total()} good packets lost")
        if counters.packets != accepted.total():
            wrong.append(f"{counters.packets} packets counted, {accepted.total()} accepted")
        session = open_session(self.folder)
        pipeline, digest = Pipeline(DEVICE, estimators(DEVICE, Setup())), Digest()
        for block in run_over(WireReader(session.wire_path), pipeline):
            digest.update(block)
        if digest.hexdigest() != summary.results_digest or pipeline.counters != counters:
            wrong.append("the replay differs from the run")
        return wrong


COMPARED = ("packet_counter", "gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z", "mag_x")
Sample = tuple[float, ...]


def packets_of(block: SampleBlock) -> list[Sample]:
    """Return what tells each sample from all others."""
    return list(zip(*(block[name].tolist() for name in COMPARED), strict=True)) if len(block) else []


def as_rows(packets: Counter[bytes]) -> Counter[Sample]:
    """Return the samples that packets hold, each decoded from a stream of nothing but whole packets."""
    decoder = DEVICE.decoder()
    decoder.feed(b"".join(packets.elements()), 0)
    decoder.finish()
    return Counter(packets_of(decoder.take()))


def strike_all(
    folder: Path,
    names: Sequence[str],
    seed: int,
    healthy_s: float = HEALTHY_S,
    promised_s: float = PROMISED_S,
) -> Iterator[tuple[str, Outcome]]:
    """Let faults happen one after the other in one session; the last outcome is that of all of it."""
    warm_up(DEVICE, Setup())
    line = Line(folder / "ahrs", seed)
    try:
        watched = Watched(line, folder / "session")
        line.send(0.3)
        for name in names:
            yield name, watched.strike(FAULTS[name], healthy_s, promised_s)
        yield "the session of all these", Outcome(0.0, watched.finish())
    finally:
        line.close()


LOOT = 200
"""Bytes that the other process takes before it stops."""
THIEF = """
import os, sys
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
print("open", flush=True)
sys.stdin.readline()
taken = 0
while taken < int(sys.argv[2]):
    try:
        taken += len(os.read(port, 4096))
    except BlockingIOError:
        pass
print(taken, flush=True)
"""


def steal(folder: Path, seed: int, healthy_s: float = HEALTHY_S, promised_s: float = PROMISED_S) -> Outcome:
    """Let another process that has the port open take some bytes."""
    warm_up(DEVICE, Setup())
    line = Line(folder / "ahrs", seed)
    command = [sys.executable, "-c", THIEF, line.port.path, str(LOOT)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as thief:
        asked, says = thief.stdin, thief.stdout
        assert asked is not None
        assert says is not None

        def strike(line: Line) -> None:
            sure = line.sure.copy()
            asked.write("go\n")
            asked.flush()
            while not select.select([says], [], [], 0.0)[0]:
                line.send(0.1)
            line.stolen = int(says.readline())
            line.unsure, line.sure = line.sure - sure, sure

        try:
            says.readline()
            watched = Watched(line, folder / "session")
            outcome = watched.strike(LineFault(strike, data="warning: losses"), healthy_s, promised_s)
            outcome.wrong += watched.finish()
        finally:
            thief.kill()
            line.close()
    said = [item for item in WireReader(folder / "session" / "wire.mcap") if isinstance(item, Event)]
    if not line.stolen or EventKind.SHARED not in [event.kind for event in said]:
        outcome.wrong.append(f"{line.stolen} bytes were stolen, and the run said {said}")
    return outcome


def attack_all(folder: Path, times: int, seed: int, healthy_s: float = HEALTHY_S) -> Iterator[Row]:
    """Let each fault happen so many times, in sessions of all faults in another order."""
    found: dict[str, list[Outcome]] = {}
    rng = np.random.default_rng(seed)
    for n in range(times):
        (folder / str(n) / "thief").mkdir(parents=True)
        for name, outcome in strike_all(
            folder / str(n), rng.permutation(list(FAULTS)).tolist(), n, healthy_s
        ):
            found.setdefault(name, []).append(outcome)
        stolen = steal(folder / str(n) / "thief", n, healthy_s)
        found.setdefault("another process takes 200 bytes", []).append(stolen)
    for name in (*FAULTS, *(found.keys() - FAULTS)):
        outcomes = found[name]
        wrong = [text for outcome in outcomes for text in outcome.wrong]
        latest = max(outcome.recovered_s for outcome in outcomes)
        said = f"decoding again after {latest:.3f} s at most"
        if name.startswith("the session"):
            said = "every byte and packet accounted for, recording and replay the same"
        yield Row(name, len(outcomes), "; ".join(sorted(set(wrong))) or said, held=not wrong)

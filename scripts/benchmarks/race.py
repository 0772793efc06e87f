"""The same bytes through imumon and through other packages, up to their values, which must agree."""

import math
import socket
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
from study import Table

from benchmarks.decoding import cut, decoded, feed_all, samples
from benchmarks.measure import Result, measure
from imumon.blocks import FloatArray
from imumon.protocols.device import load_device

PACKETS = 4000
CHUNK, THEIR_CHUNK = 65_536, 4096
"""Each is given what it is fastest with."""
ROUNDS = 40
"""Calls of others are long: on a busy machine few of them are not interrupted."""
LONGEST_WAIT_S = 5.0
"""For a package that reads in a thread of its own."""
DEG = math.pi / 180.0


@dataclass(frozen=True, slots=True)
class Peer:
    """Another package that decodes what a device sends.

    Parameters
    ----------
    package, module : str
        As it is installed and imported.
    device, column : str
        Of imumon; the column of the values that are compared.
    unit : float
        What the package's unit is in imumon's.
    decode : callable
        Takes the module, the bytes and the number of values.
    way : str
        How it was run.
    """

    package: str
    module: str
    device: str
    column: str
    unit: float
    decode: Callable[[Any, bytes, int], Sequence[float]]
    way: str = ""


def _mscl(mscl: Any, data: bytes, count: int) -> Sequence[float]:
    """Read from a socket, as the library takes bytes from connections only."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        Thread(target=partial(_send, server, data), daemon=True).start()
        connection = mscl.Connection.TcpIp(*server.getsockname())
        node, found = mscl.InertialNode(connection), list[float]()
        until = time.monotonic() + LONGEST_WAIT_S
        while len(found) < count and time.monotonic() < until:
            for packet in node.getDataPackets(0):
                points = packet.data()
                found.append(next(p.as_double() for p in points if p.channelName() == "scaledGyroX"))
        connection.disconnect()
    return found


def _send(server: socket.socket, data: bytes) -> None:
    with server.accept()[0] as client:
        client.sendall(data)
        client.recv(1)  # until it hangs up


def _ximu3(ximu3: Any, data: bytes, count: int) -> Sequence[float]:
    """Read from a file, as the library takes bytes from connections and files only."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "race.ximu3")
        path.write_bytes(data)
        found: list[float] = []
        connection = ximu3.Connection(ximu3.FileConnectionConfig(str(path)))
        connection.add_inertial_callback(lambda message: found.append(message.gyroscope_x))
        connection.open()
        until = time.monotonic() + LONGEST_WAIT_S
        while len(found) < count and time.monotonic() < until:
            time.sleep(1e-4)
        connection.close()
    return found


def _mavlink(common: Any, data: bytes, _: int) -> Sequence[float]:
    parser = common.MAVLink(None)
    messages: list[Any] = []
    for start in range(0, len(data), THEIR_CHUNK):
        messages += parser.parse_buffer(data[start : start + THEIR_CHUNK]) or []
    return [message.xgyro for message in messages]


def _nmea(pynmea2: Any, data: bytes, _: int) -> Sequence[float]:
    reader, text = pynmea2.NMEAStreamReader(), data.decode("ascii")
    parts = (text[start : start + THEIR_CHUNK] for start in range(0, len(text), THEIR_CHUNK))
    return [float(sentence.data[4]) for part in parts for sentence in reader.next(part)]


PEERS = (
    Peer("pymscl", "mscl", "microstrain", "gyro_x", 1.0, _mscl, "the maker's; from a local socket"),
    Peer("ximu3", "ximu3", "ximu3", "gyro_x", DEG, _ximu3, "the maker's; from a file"),
    Peer(
        "pymavlink", "pymavlink.dialects.v20.common", "mavlink", "gyro_x", 1.0, _mavlink, "the protocol's own"
    ),
    Peer("pynmea2", "pynmea2", "nmea", "roll", DEG, _nmea),
)
NOTES = (
    "Each decodes the same {packets} samples, which imumon's encoders wrote, in pieces of the size that it "
    "is fastest with, and hands over what it makes of them: imumon all columns as arrays, the others one "
    "value of each packet as a list, which is less to do. imumon searches and verifies in all of these.\n\n"
    "Best of {rounds} rounds in which all take turns. The difference is the largest between the values, over "
    "the largest value; a package that gave another number of values has that number instead.\n\n"
    "Not in the race, as of November 2026: for Xsens, `mti8-navigation` 1.0.0 takes the checksum for an "
    "exclusive or and accepts no packet; for Aceinna, `openimu` 2.6.1 needs packages that it does not name; "
    "for VectorNav, `vectornav-vn200` 0.1.0 queries registers and reads no stream; for the BNO08x, "
    "Adafruit's needs CircuitPython's ports. On PyPI none was found for SBG, STIM300, HiPNUC, Inertial Sense "
    "and KVH."
)


def named(package: str) -> str | None:
    """Return a package's name with its version; None where it is not installed."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return None


def faster(other: float, imumon: float) -> str:
    """Return who is faster, and how many times, from the times that both take."""
    if imumon <= other:
        return f"imumon {other / imumon:.3g} ×"
    return f"**the other {imumon / other:.3g} ×**"


def difference(found: Sequence[float], unit: float, true: FloatArray) -> str:
    """Return how far the values of a package are from imumon's, or how many there are where that differs."""
    values, true = np.array(found) * unit, true[np.isfinite(true)]
    if len(values) != len(true):
        return f"{len(values)} of {len(true)}"
    return f"{np.abs(values - true).max() / np.abs(true).max():.0e}"


def decoders(packets: int = PACKETS, rounds: int = ROUNDS) -> Table:
    """Measure every peer that is installed; one that is not has a row that states it."""
    functions: dict[str, Callable[[], object]] = {}
    apart: dict[str, str] = {}
    for peer in PEERS:
        made = load_device(peer.device)
        data = b"".join(made.encoder().encode(samples(packets)))
        functions[f"imumon {peer.device}"] = partial(feed_all, made.decoder(), cut(data, CHUNK), False)
        if named(peer.package):
            true = decoded(made, data, CHUNK)[peer.column]
            decode = partial(peer.decode, import_module(peer.module), data, int(np.isfinite(true).sum()))
            functions[peer.package] = decode
            apart[peer.package] = difference(decode(), peer.unit, true)
    times = measure(functions, rounds)
    rows = []
    for peer in PEERS:
        own_us, name = times[f"imumon {peer.device}"] / packets * 1e-3, named(peer.package)
        figures = ["not installed", "-", "-"]
        if name:
            other = times[peer.package] / packets * 1e-3
            figures = [f"{other:.2f}", faster(other, own_us), apart[peer.package]]
        rows.append([name or peer.package, peer.device, figures[0], f"{own_us:.2f}", *figures[1:], peer.way])
    heads = ["other", "packet", "the other, µs", "imumon, µs", "faster", "difference", "how the other ran"]
    return Table("## Decoding", heads, rows, NOTES.format(packets=packets, rounds=rounds))


def race() -> Result:
    """Run it; nothing here is a bar, as a row states itself who is better."""
    return [decoders()], []

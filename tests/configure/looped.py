"""A device on the other end of a line without a port and without waiting: time passes as it is read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace
from typing import cast

import pytest

from imumon.blocks import SampleBlock, join
from imumon.configure import command_link
from imumon.configure.command_link import CommandLink
from imumon.configure.configuration import Configuration, Report
from imumon.configure.core import Wish, family_of
from imumon.configure.firmware import Firmware, Sending
from imumon.errors import ImumonError
from imumon.protocols.device import DeviceFile, load_device
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.unit.unit import CHUNK
from imumon.transport.port import Port
from imumon.transport.ports import lost_error
from imumon.transport.settings import PortSettings
from imumon.wing import firmware_of
from tests.configure.faults import Spoilt


@cache
def device_of(name: str) -> DeviceFile:
    """Return a device, read once for all tests."""
    return load_device(name)


class Played:
    """What a unit sends, simulated once for all ports."""

    def __init__(self, unit: SimulatedUnit) -> None:
        self._unit = unit
        self._made = unit.samples(CHUNK)

    def rows(self, start: int, stop: int) -> SampleBlock:
        """Return samples by their number since power-on."""
        while stop > len(self._made):
            self._made = join([self._made, self._unit.samples(CHUNK)])
        return self._made.rows(start, stop)


@cache
def played(name: str, rate_hz: float) -> Played:
    """Return what a unit sends at a rate in the axes of a device."""
    return Played(SimulatedUnit(load_scenario("bench").played(rate_hz, device_of(name).axes)))


@cache
def as_delivered(name: str, rate_hz: float, first: int, n: int) -> bytes:
    """Return what a device as delivered sends of samples of its unit, encoded once for all ports."""
    return b"".join(device_of(name).encoder().encode(played(name, rate_hz).rows(first, first + n)))


class Sent:
    """What a device sends from a sample of its unit on, encoded once for all ports."""

    def __init__(self, sending: Sending, unit: Played, first: int) -> None:
        self.rate_hz = sending.rate_hz
        self._sending, self._unit, self._first = sending, unit, first
        self._made: list[bytes] = []

    def of_rows(self, start: int, n: int) -> bytes:
        """Return the packets of samples by their number since power-on."""
        start -= self._first
        for row in range(self._first + len(self._made), self._first + start + n):
            self._made.append(self._sending.encode(self._unit.rows(row, row + 1)))
        return b"".join(self._made[start : start + n])


SENT: dict[tuple[object, ...], Sent] = {}
"""By device, its rate, its settings, its kinds of packets, and the sample from which on it has them."""


class LoopedPort:
    """What `CommandLink` asks of a port, with the firmware of a virtual device behind it."""

    def __init__(self, name: str, rate_hz: float) -> None:
        self.device = device_of(name)
        made = firmware_of(self.device.protocol)(self.device, rate_hz)
        assert made is not None
        self.firmware: Firmware = made
        self.spoilt = Spoilt().spoil(made)
        self.settings = PortSettings("/dev/looped", self.device.serial.baudrates[0])
        self.shared_with: tuple[str, ...] = ()
        self.now_s = 1000.0
        self.on_write: Callable[[int], None] = lambda _: None
        self.writes = 0
        self._name, self._rate_hz = name, rate_hz
        self._answers = b""
        self._samples = 0.0
        self._sending: Sent | None = None
        self._sent_by = dict(self.firmware.volatile)
        self._sent: Counter[float] = Counter()

    def monotonic(self) -> float:
        return self.now_s

    def time_ns(self) -> int:
        return round(self.now_s * 1e9)

    def set_baudrate(self, baudrate: int) -> None:
        self.settings = replace(self.settings, baudrate=baudrate)

    def write(self, data: bytes) -> None:
        self._look()
        self.writes += 1
        self.on_write(self.writes)
        if self.settings.baudrate == self.firmware.baudrate:
            self._answers += self.firmware.receive(data)
        self._look()

    def read(self, timeout_s: float) -> bytes:
        self._look()
        self.now_s += 1e-4
        if self._answers:
            data, self._answers = self._answers, b""
            return data
        self.now_s += max(timeout_s, 0.0)
        return self._data(timeout_s) if timeout_s > 0 else b""

    def close(self) -> None:
        pass

    def _look(self) -> None:
        if self.spoilt.unplugged:
            raise lost_error(self.settings, "the device hung up")

    def _data(self, seconds: float) -> bytes:
        firmware = self.firmware
        if self.spoilt.dead or not firmware.streaming or self.settings.baudrate != firmware.baudrate:
            return b""
        if firmware.volatile != self._sent_by:
            self._sent_by = dict(firmware.volatile)
            self._sending = self._sent_with(firmware.sending())
        rate = self._rate_hz if self._sending is None else self._sending.rate_hz
        self._samples += seconds * rate
        n, self._samples = int(self._samples), self._samples % 1.0
        first = self._sent[rate]
        self._sent[rate] += n
        if self._sending is None:
            return as_delivered(self._name, rate, first, n)
        return self._sending.of_rows(first, n)

    def _sent_with(self, sending: Sending | None) -> Sent | None:
        if sending is None:
            return None
        first = self._sent[sending.rate_hz]
        kinds = repr(self.firmware.family.kinds(self.firmware.volatile))  # which a test may change
        key = (self._name, self._rate_hz, frozenset(self._sent_by.items()), kinds, first)
        return SENT.setdefault(key, Sent(sending, played(self._name, sending.rate_hz), first))


@dataclass
class Looped:
    """A device on a line, and what becomes of it."""

    port: LoopedPort
    configuration: Configuration
    report: Report

    @property
    def as_found(self) -> bool:
        """Whether volatile settings, flash and line are those that the device was delivered with."""
        firmware = self.port.firmware
        same = firmware.volatile == firmware.flash == firmware.delivered
        return same and firmware.streaming and firmware.baudrate == self.port.device.serial.baudrates[0]


def looped(monkeypatch: pytest.MonkeyPatch, name: str, rate_hz: float | None = None) -> Looped:
    """Return a device that streams, and what configures it; clocks go as the port is read."""
    port = LoopedPort(name, rate_hz or device_of(name).rate_hz or 100.0)
    clock = SimpleNamespace(monotonic=port.monotonic, time_ns=port.time_ns)
    monkeypatch.setattr(command_link, "time", clock)
    link = CommandLink(cast(Port, port), family_of(port.device))
    link.streaming = True
    report = Report(port.device.name, port.settings.url)
    return Looped(port, Configuration(link, port.device, report, lambda _: None), report)


def failed(one: Looped, wish: Wish) -> ImumonError:
    """Return the error of a configuration that must fail."""
    with pytest.raises(ImumonError) as caught:
        one.configuration.run(wish)
    assert one.report.result == "failed"
    return caught.value

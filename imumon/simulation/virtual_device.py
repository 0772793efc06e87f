"""A virtual AHRS: a simulated unit behind a real pseudo-terminal, sending packets at its rate.

Where imumon can configure devices of its kind, it answers the same commands and carries them out.
"""

import threading
import time
from collections import deque
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from imumon.errors import ImumonError, bad_config
from imumon.protocols.device import DeviceFile
from imumon.wing import firmware_of

from .unit import Scenario, SimulatedUnit, load_scenario
from .unit.unit import MICROSECOND
from .virtual_port import BITS_PER_BYTE, VirtualPort

DEFAULT_RATE_HZ = 100.0
TICK_S = 0.005
"""How often commands are looked for, and packets handed over by a device that sends faster than this."""
AHEAD_S = 0.25
"""Packets of so long are made at once, which takes hardly longer than to make one."""


def switch_on(device: DeviceFile, scenario: Scenario, seed: int) -> SimulatedUnit:
    """Return a unit that plays a scenario and counts its time as the device does."""
    return SimulatedUnit(scenario, seed, device.decoder().timing.tick_ns or MICROSECOND)


def refuse_overload(device: DeviceFile, scenario: Scenario) -> None:
    """Raise BAD_CONFIG when a device cannot send its packets at the rate of a scenario through its line."""
    packet_bytes = len(device.encoder().encode(switch_on(device, scenario, 0).samples(1))[0])
    baudrate = device.serial.baudrates[0]
    load = packet_bytes * BITS_PER_BYTE * scenario.rate_hz / baudrate
    if load > 1.0:
        raise bad_config(
            f"{scenario.rate_hz:g} packets/s of {packet_bytes} bytes are {load:.0%} of a line at {baudrate} "
            "baud",
            "choose a lower rate, or a device file with a higher baud rate first in its list",
        )


class VirtualDevice(AbstractContextManager["VirtualDevice"]):
    """Sends the packets of a device in real time from its own thread until it is closed.

    Raises BAD_CONFIG when the packets do not fit through the line at this rate.

    `link`: name of a symlink to the port.
    `rate_hz`: packets per second; those of the scenario, else the device file's own, when None.
    `port`: port to send through; one is made when None.  Closed with the device.
    `scenario`: what the unit does, in the axes of the device; the scenario "bench" when None.
    """

    def __init__(
        self,
        device: DeviceFile,
        link: Path | None = None,
        rate_hz: float | None = None,
        seed: int = 0,
        port: VirtualPort | None = None,
        scenario: Scenario | None = None,
    ) -> None:
        plan = scenario or load_scenario("bench")
        self._default_hz = rate_hz or (scenario and scenario.rate_hz) or device.rate_hz or DEFAULT_RATE_HZ
        self._device, self._plan, self._seed = device, plan, seed
        self._encoder = device.encoder()
        self._begin(self._default_hz, seed)
        refuse_overload(device, plan.played(self._rate_hz, device.axes))
        self._rebooted = False
        make = firmware_of(device.protocol)
        self.firmware: Any = None if make is None else make(device, self._default_hz)
        """What answers commands, of the wing that has some for it; None for a device that does not listen."""
        self._sending: Any = None
        self._closing = threading.Event()
        self.packets_sent = 0
        self.failure: ImumonError | None = None
        """Why nothing is sent any more: a value of the simulated unit does not fit its field."""
        self.port = port or VirtualPort(link, device.serial.baudrates[0])
        self._thread = threading.Thread(target=self._run, name="virtual device", daemon=True)
        self._thread.start()

    def reboot(self) -> None:
        """Switch it off and on: its counter and clock begin at zero, its settings are those in flash."""
        self._rebooted = True

    def close(self) -> None:
        """Stop sending and remove the port."""
        self._closing.set()
        self._thread.join()
        self.port.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _begin(self, rate_hz: float, seed: int) -> None:
        """Switch the unit on; it sends packets at this rate."""
        self._rate_hz = rate_hz
        self._unit = switch_on(self._device, self._plan.played(rate_hz, self._device.axes), seed)
        self._packets = deque[bytes]()

    def _run(self) -> None:
        start, sent = time.monotonic(), 0
        while not self._closing.is_set():
            if self._rebooted:
                self._reboot()
            if self._obeyed():
                start, sent = time.monotonic(), 0
            due = int((time.monotonic() - start) * self._rate_hz) - sent
            if due > 0:
                try:
                    self._send(due)
                except ImumonError as error:
                    self.failure = error
                    return
                sent += due
            next_due = start + (sent + 1) / self._rate_hz
            wait = max(next_due - time.monotonic(), TICK_S if self._rate_hz > 1 / TICK_S else 0.0)
            self._closing.wait(wait if self.firmware is None else min(wait, TICK_S))

    def _send(self, n: int) -> None:
        if self._sending is not None:
            self.port.write(self._sending.encode(self._unit.samples(n)))
        else:
            while len(self._packets) < n:
                ahead = max(round(AHEAD_S * self._rate_hz), 1)
                self._packets.extend(self._encoder.encode(self._unit.samples(ahead)))
            for _ in range(n):
                self.port.write(self._packets.popleft())
        self.packets_sent += n

    def _reboot(self) -> None:
        self._rebooted = False
        if self.firmware is not None:
            self.firmware.power_on()
            self._configure(self._seed + 1)
        else:
            self._begin(self._rate_hz, self._seed + 1)

    def _obeyed(self) -> bool:
        """Answer the commands that have come; return whether the samples begin anew, or none are sent."""
        firmware = self.firmware
        if firmware is None:
            return False
        received = self.port.read()
        if received:
            before = dict(firmware.volatile)
            self.port.write(firmware.receive(received))
            if firmware.baudrate != self.port.baudrate:
                self.port.drain()  # the answer goes at the old rate
                self.port.baudrate = firmware.baudrate
            if firmware.volatile != before:
                self._configure(self._seed)
                return True
        return not firmware.streaming

    def _configure(self, seed: int) -> None:
        """Send from now on as the settings require."""
        self._sending = self.firmware.sending()
        self._begin(self._default_hz if self._sending is None else self._sending.rate_hz, seed)
        self.port.baudrate = self.firmware.baudrate

"""A virtual port that can fall silent, and whose adapter can hold bytes back."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Self

from imumon.simulation.virtual_port import CHUNK_S, VirtualPort


class FaultyPort(VirtualPort):
    """A port whose device can be muted; `held_s` is the line time of what is handed over at once, in s.

    0.016 s is an adapter with its usual latency timer.
    """

    def __init__(self, link: Path | None = None, baudrate: int = 115200) -> None:
        self.held_s = CHUNK_S
        self._mute = False
        super().__init__(link, baudrate)

    def __enter__(self) -> Self:
        return self

    def write(self, data: bytes) -> None:
        """Send bytes, unless the device is mute: then they are lost."""
        with self._changed:
            if self._mute:
                self.bytes_lost += len(data)
            else:
                super().write(data)

    def silence(self) -> None:
        """Let the device send nothing more until `resume`; what it writes is lost."""
        with self._changed:
            self._mute = True
            self._lose_backlog()

    def resume(self) -> None:
        """Let the device send again."""
        self._mute = False

    def _ready(self, rate: float) -> int:
        whole = rate * self.held_s
        if self.held_s > CHUNK_S:
            self._changed.wait_for(lambda: self._closing or len(self._backlog) >= whole, self.held_s)
        return min(len(self._backlog), math.ceil(whole))

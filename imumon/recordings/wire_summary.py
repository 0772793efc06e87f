"""What a wire file held, and what it lacks: known after it was read to its end."""

from __future__ import annotations

from dataclasses import dataclass, field

KEPT_PLACES = 100
"""Damaged places of which the details are kept; all are counted."""


@dataclass(frozen=True, slots=True)
class Place:
    """A place of a wire file at which something is missing."""

    offset: int
    size: int
    """Where in the file, and how many bytes of the file are of no use there; 0 when bytes were cut out."""
    after_ns: int
    before_ns: int
    """Unix time of the last message before, and of the last one lost or the first one behind; 0 when there
    is none."""
    messages: int
    """Reads and events that are missing, as the numbers of those before and behind say."""

    @property
    def seconds(self) -> float:
        """Time that it spans."""
        return max(0, self.before_ns - self.after_ns) * 1e-9 if self.after_ns and self.before_ns else 0.0


@dataclass(slots=True)
class Damage:
    """What a wire file lacks."""

    places: int = 0
    bytes: int = 0
    """Bytes of the file that are of no use."""
    messages: int = 0
    """Reads and events that are missing."""
    events: int = 0
    """Events that are there and cannot be understood."""
    seconds: float = 0.0
    """Time that the places span."""
    where: list[Place] = field(default_factory=list)
    """The first places, with their details."""

    def add(self, place: Place) -> None:
        """Count a place."""
        self.places += 1
        self.bytes += place.size
        self.messages += place.messages
        self.seconds += place.seconds
        if len(self.where) < KEPT_PLACES:
            self.where.append(place)


@dataclass(slots=True)
class WireSummary:
    """What a wire file held."""

    reads: int = 0
    bytes: int = 0
    events: int = 0
    bytes_unrecorded: int = 0
    """Bytes that came from the device and are not in the file, as the file says."""
    tail_bytes: int = 0
    """Bytes at the end of the file that are not a whole record, or are damaged: not of use."""
    complete: bool = False
    """The file was finished in order; False after a power failure, a kill or a full disk."""
    checksum_ok: bool | None = None
    """Whether the checksum over the file agrees; None when there is none because it was not finished."""
    last_ns: int = 0
    """Unix time of the last message."""
    damage: Damage = field(default_factory=Damage)
    """What is missing, now or before the file was written anew."""
    recovered: Damage = field(default_factory=Damage)
    """Of `damage`, what the file says was missing already when it was written."""
    metadata: dict[str, str] = field(default_factory=dict)
    """What the recording program wanted to say."""

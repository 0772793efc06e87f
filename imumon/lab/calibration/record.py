"""What a calibration is made of: recordings, read through the pipeline and reduced to means at rest."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from imumon.blocks import BoolArray, FloatArray, SampleBlock
from imumon.columns import TEMPERATURES
from imumon.errors import bad_data
from imumon.estimation.gyro_bias.stage import RestDetector
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.pipeline import Estimator
from imumon.protocols.device import DeviceFile
from imumon.protocols.thermometer import TemperatureRateParameters
from imumon.recordings.reader import open_recording
from imumon.recordings.reduced import ACCEL, AXES, GYRO, Reduced, reduce
from imumon.recordings.source import Count, no_count

COLUMNS = (*GYRO, *ACCEL, *TEMPERATURES, "temperature_estimate", *(f"temperature_estimate_{a}" for a in AXES))
BLOCK_S = 10.0
"""Length of a block: long against the sample noise, short against a chamber's ramps."""
LEAST_COVERED = 0.5
"""A block whose samples span less than this share of it is passed over."""


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """The block means of one recording."""

    name: str
    sha256: str
    """Where it comes from, and the fingerprint of its bytes."""
    device: str | None
    axes: str | None
    means: Reduced
    """Over `COLUMNS`."""
    rest: BoolArray
    """Blocks at rest and complete, (n,)."""
    serial: str | None = None

    def of(self, name: str) -> FloatArray:
        """Return the block means of a column, (n,)."""
        return self.means.of(name)

    def has(self, name: str) -> bool:
        """Return whether a column has any value."""
        return self.means.has(name)

    def temperature_column(self, channel: str) -> str | None:
        """Return the column with the temperature of a channel: its own sensor's, estimated, if there is."""
        axis = channel[-2:]
        own = ("temperature_estimate" + axis, "temperature_estimate", "temperature" + axis, "temperature")
        return next((name for name in own if self.has(name)), None)


def record_of(
    blocks: Iterable[SampleBlock],
    name: str,
    sha256: str,
    device: str | None = None,
    axes: str | None = None,
    serial: str | None = None,
) -> Record:
    """Reduce samples that went through the pipeline."""
    means = reduce(blocks, COLUMNS, BLOCK_S)
    rest = means.at_rest() & (means.span_s >= LEAST_COVERED * BLOCK_S)
    return Record(name, sha256, device, axes, means, rest, serial)


def read_session(path: Path, count: Count = no_count) -> tuple[Record, list[str]]:
    """Read a session, recorded or imported; return its record, and what the user should know of it.

    Raises BAD_DATA when there is no session, or it cannot be read.
    """
    recording = open_recording(path, _stages, count=count)
    known = recording.name, recording.sha256(), recording.device, recording.axes, recording.serial
    record = record_of(recording.blocks(), *known)
    if not len(record.means):
        raise bad_data(f"{path}: there is no sample in this session")
    return record, [f"{path}: {text}" for text in recording.warnings()]


def _stages(device: DeviceFile | None) -> Sequence[Estimator]:
    temperature = device.temperature if device is not None else TemperatureRateParameters()
    return [TemperatureRate(parameters=temperature), RestDetector()]

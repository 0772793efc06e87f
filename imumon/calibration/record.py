"""What a calibration is made of: sessions, read through the pipeline and reduced to means at rest."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.calibration.reduction import BlockMeans, BlockReducer
from imumon.calibration.stillness import Mask, at_rest
from imumon.errors import ImumonError, Reason
from imumon.estimation.rest.stage import RestDetector
from imumon.protocols.thermometer import TemperatureRateParameters
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.pipeline import Estimator, Pipeline
from imumon.recordings.folder import Session, open_session
from imumon.run.replay import run_over
from imumon.run.source import open_source

AXES = "xyz"
GYRO = tuple(f"gyro_{axis}" for axis in AXES)
ACCEL = tuple(f"accel_{axis}" for axis in AXES)
TEMPERATURES = tuple(
    f"{kind}{suffix}"
    for kind in ("temperature_estimate", "temperature")
    for suffix in ("", *(f"_{axis}" for axis in AXES))
)
MOST_MISSING = 0.5
"""A block with fewer than this share of a full one's span is passed over."""


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """The blocks of one recording.

    Parameters
    ----------
    name, sha256 : str
        Where it comes from, and the fingerprint of its bytes.
    device, axes : str or None
    means : BlockMeans
        Over `GYRO`, `ACCEL` and `TEMPERATURES`.
    rest : array (n,) of bool
        Blocks at rest and complete.
    """

    name: str
    sha256: str
    device: str | None
    axes: str | None
    means: BlockMeans
    rest: Mask

    def of(self, name: str) -> FloatArray:
        """Return the block means of a column, (n,)."""
        return self.means.mean[:, self.means.names.index(name)]

    def has(self, name: str) -> bool:
        """Tell whether a column has any value."""
        return bool(np.isfinite(self.of(name)).any())

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
    block_s: float = 10.0,
) -> Record:
    """Reduce samples that went through the pipeline."""
    reducer = BlockReducer((*GYRO, *ACCEL, *TEMPERATURES), block_s)
    for block in blocks:
        reducer.process(block)
    means = reducer.finish()
    complete = means.span_s >= MOST_MISSING * block_s
    rest = at_rest(means, means.columns(GYRO), means.columns(ACCEL)) & complete
    return Record(name, sha256, device, axes, means, rest)


def read_session(path: Path) -> tuple[Record, list[str]]:
    """Read a session, recorded or imported; return its record, and what the user should know of it.

    Raises
    ------
    ImumonError
        BAD_DATA when there is no session, or it cannot be read.
    """
    session = open_session(path)
    source = open_source(path)
    temperature = source.device.temperature if source.device else TemperatureRateParameters()
    stages: list[Estimator] = [TemperatureRate(parameters=temperature), RestDetector()]
    pipeline = Pipeline(source.device, stages)
    metadata = session.metadata
    device = None if metadata.device == "import" else metadata.device
    record = record_of(
        run_over(source.items, pipeline), session.path.name, _fingerprint(session), device, metadata.axes
    )
    if not len(record.means):
        raise ImumonError(Reason.BAD_DATA, f"{path}: there is no sample in this session")
    return record, [f"{path}: {text}" for text in [*source.warnings(), *pipeline.warnings()]]


def _fingerprint(session: Session) -> str:
    imported = session.metadata.source == "import"
    with (session.samples_path if imported else session.wire_path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

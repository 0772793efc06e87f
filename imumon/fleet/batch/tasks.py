"""One session through one command: what a worker does, and what it sends back.

Code that hangs cannot be stopped from outside it, least of all a compiled loop or a file that never answers.
So where a session has a limit of time its worker is ended by `faulthandler`, which needs nothing of Python to
do that, and leaves a note.  Dask starts the worker again and gives the session to another, which finds the
note.
"""

import faulthandler
import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imumon.blocks import SampleBlock
from imumon.clock.checks import Intervals
from imumon.errors import ImumonError, Reason, bad_config, bad_data
from imumon.pipeline import Digest, Pipeline
from imumon.recordings.exports import export_run
from imumon.recordings.folder import open_session
from imumon.recordings.source import open_source, run_over
from imumon.run.replay import compare_with_live, digested
from imumon.run.setup import parse_setup, recorded_setup
from imumon.run.stages import pipeline_of
from imumon.version import __version__

from .dataset import BatchOptions, Row
from .places import fetched


@dataclass(frozen=True)
class Job:
    """A session by its path or URL, what is to be done with it, and how long a worker may take.

    `out` is the folder of the batch, which every worker sees under the same path; `version` that of the
    imumon that submits the job.
    """

    place: str
    options: BatchOptions
    out: str
    version: str = __version__
    limit_s: float | None = None

    def file(self, folder: str, suffix: str) -> Path:
        """Return where a file of this session goes; two sessions of one name have two."""
        name = Path(self.place.partition("?")[0]).name
        digest = hashlib.sha256(self.place.encode()).hexdigest()
        path = Path(self.out) / folder / f"{name}-{digest[:8]}{suffix}"
        path.parent.mkdir(exist_ok=True)
        return path


def work(job: Job) -> list[Row]:
    """Do a job; return the rows of its session, or one that holds why there are none.

    Any other error is a defect, and goes to the caller.
    """
    what: dict[str, Any] = {"session": job.place}
    try:
        if job.version != __version__:
            raise bad_config(f"the worker has imumon {__version__}, the batch is of {job.version}")
        folder = _folder()
        limit: AbstractContextManager[None] = nullcontext()
        if job.limit_s is not None and folder is not None:  # only a worker may end
            limit = limited(job.file("late", ".txt"), job.limit_s)
        with limit, fetched(job.place, folder) as path:
            metadata = open_session(path).metadata
            what |= {"device": metadata.device, "serial": metadata.serial, "begun": metadata.created_ns}
            rows: list[Row] = [{**what, **row} for row in _COMMANDS[job.options.command](path, job)]
        if not rows:
            raise bad_data(f"{job.place}: has no channel that {job.options.command} knows")
    except ImumonError as error:
        return [what | failure(job.place, error.reason.value, error.line)]
    except OSError as error:
        text = f"{error.filename or job.place}: {error.strerror or error}"
        return [what | failure(job.place, "system", text)]
    return rows


def failure(place: str, reason: str, error: str) -> dict[str, Any]:
    """Return the row of a session that failed."""
    return {"session": place, "reason": reason, "error": error}


def _folder() -> Path | None:
    """Return the folder that goes with the worker, also when it is killed; None without a worker."""
    if "distributed" in sys.modules:
        from distributed import get_worker

        with suppress(ValueError):  # this is no worker
            return Path(get_worker().local_directory)
    return None


@contextmanager
def limited(note: Path, limit_s: float) -> Iterator[None]:
    """End this process where what follows takes longer, and report it in the note; one thread at a time.

    Raises TIMEOUT when there is such a note already; whoever finds it takes it away.
    """
    with suppress(FileNotFoundError):
        late = note.stat().st_size > 0  # an empty one is of a worker that died before the time was over
        note.unlink()
        if late:
            raise ImumonError(Reason.TIMEOUT, "was not done after its --timeout")
    with note.open("w") as file:
        faulthandler.dump_traceback_later(limit_s, exit=True, file=file)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()
            note.unlink(missing_ok=True)


class Channels:
    """Number, mean and scatter of each channel of a recording, as the stages see it."""

    def __init__(self) -> None:
        self._parts: dict[str, list[tuple[float, ...]]] = {}
        """By channel, of each block: number, mean, variance, least and greatest of the finite values."""
        self._intervals = Intervals()

    def add(self, block: SampleBlock) -> None:
        """Add the samples of a block."""
        self._intervals.add(block["device_time_ns"], block["segment"])
        for name, values in block.columns.items():
            if values.dtype == np.float64 and len(known := values[np.isfinite(values)]):
                part = len(known), known.mean(), known.var(), known.min(), known.max()
                self._parts.setdefault(name, []).append(part)

    def rows(self) -> Iterator[Row]:
        """Yield what is known of each channel; the standard deviation of fewer than two values is None."""
        for name, parts in self._parts.items():
            counts, means, variances, least, greatest = np.array(parts).T
            count = counts.sum()
            mean = counts @ means / count
            squares = counts @ (variances + (means - mean) ** 2)
            sd = np.sqrt(squares / (count - 1)) if count > 1 else None
            yield {
                "channel": name, "samples": int(count), "mean": mean, "sd": sd,
                "least": least.min(), "greatest": greatest.max(), "duration_s": self._intervals.covered_s,
            }  # fmt: skip


def _samples(path: Path, job: Job) -> Iterator[Row]:
    """Decode or replay a recording, into a table where one is requested; yield its channels."""
    source, channels, digest = open_source(path), Channels(), Digest()
    session = open_session(path) if job.options.command == "replay" else None
    if session is None:
        pipeline = Pipeline(source.device, ranges=source.range)
    else:
        text = job.options.pipeline_yaml
        setup = recorded_setup(session) if text is None else parse_setup(text, "--pipeline")
        pipeline = pipeline_of(source, setup)
    pipeline.sink = channels.add
    blocks = digested(run_over(source.items, pipeline), pipeline, digest)
    file = job.file("tables", ".parquet") if job.options.tables else None
    if file is not None:
        export_run(blocks, pipeline, source, file, None)
    else:
        for _ in blocks:
            pass
    of_all = {
        "lost": pipeline.counters.lost,
        "file": file and str(file),
        "warnings": [*source.warnings(), *pipeline.warnings()],
    }
    if session is not None:
        of_all["identical_to_live"] = compare_with_live(session, setup, digest, pipeline).identical
    units = {column.name: column.unit for column in source.columns(pipeline)}
    for row in channels.rows():
        yield {**row, "unit": units.get(row["channel"]), **of_all}


def _allan(path: Path, _: Job) -> Iterator[Row]:
    from imumon.allan.analysis import analyse
    from imumon.allan.recording import UNITS, group_of, read_channels

    opened = read_channels(path)
    for name, result in analyse(opened.series).items():
        terms = {} if result.fit is None else result.fit.terms
        known = {term: estimate for term, estimate in terms.items() if estimate is not None}
        yield {
            "channel": name, "unit": UNITS[group_of(name)],
            **{term: estimate.value for term, estimate in known.items()},
            **{f"{term}_sd": estimate.sd for term, estimate in known.items()},
            "lowest": float(result.allan.values[result.lowest]),
            "lowest_tau_s": float(result.tau_s[result.lowest]),
            "longest_tau_s": result.longest_tau_s,
            "rate_hz": result.series.rate_hz, "duration_s": result.series.duration_s,
            "warnings": [*opened.warnings],
        }  # fmt: skip


def _calibrate(path: Path, job: Job) -> Iterator[Row]:
    from imumon.lab.calibration.calibration import calibrate
    from imumon.lab.calibration.cells import read_session

    options = job.options
    serial = open_session(path).metadata.serial
    record, warnings = read_session(path)
    found = calibrate([record], options.latitude_deg, options.heading_deg, serial)
    file = job.file("models", ".yaml")
    found.model.write(file)
    for name, fit in found.fits.items():
        channel, choice = found.model.channels[name], fit.choice
        low, high = channel.temperature_range_degc
        yield {
            "channel": name, "unit": channel.unit, "curve": choice.name,
            "residual_sd": choice.residual_sd, "held_out_rms": choice.held_out_rms[choice.name],
            "fit_rms": choice.fit_rms, "lag_rms": fit.lag_rms, "rest_s": float(found.at_rest.seconds.sum()),
            "lowest_degc": low, "highest_degc": high, "file": str(file),
            "warnings": [*warnings, *found.warnings],
        }  # fmt: skip


def _diagnose(path: Path, job: Job) -> Iterator[Row]:
    from imumon.files import write_text
    from imumon.lab.diagnosis.diagnose import diagnose
    from imumon.lab.diagnosis.report import report
    from imumon.lab.diagnosis.runs import read_runs

    content = report(diagnose(read_runs(path), [], job.options.declared))
    file = job.file("reports", ".json")
    write_text(file, json.dumps(content, indent=2, ensure_ascii=False) + "\n")
    for name, channel in content["channels"].items():
        yield {
            "channel": name, "unit": channel["unit"],
            "effects": [effect["name"] for effect in channel["effects"]],
            **{key: channel[key] for key in ("unexplained", "explained_share", "noise_floor_rms", "summary")},
            **{f"{of}_rms_{when}": channel[when][f"{of}_rms"]
               for of in ("train", "test") for when in ("before", "after")},
            "file": str(file), "warnings": content["caveats"],
        }  # fmt: skip


_COMMANDS: dict[str, Callable[[Path, Job], Iterator[Row]]] = {
    "decode": _samples,
    "replay": _samples,
    "allan": _allan,
    "calibrate": _calibrate,
    "diagnose": _diagnose,
}

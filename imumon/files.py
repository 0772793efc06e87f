"""Text files read whole, or refused with the reason; files written whole or not at all; values for JSON."""

import errno
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from .errors import ImumonError, Reason, bad_config, bad_data

UNREADABLE = "give the path of a file that is there, and that you may read"
LARGEST_TEXT = 4 << 20
"""Bytes; a model of a network with a thousand hidden units has a tenth of that."""
TRUTH = ("session.yaml", "wire.mcap", "samples.parquet")
"""Where one of these is, the folder is a session."""
SESSION_FILES = (*TRUTH, "view.rrd", "log.jsonl", "truth.parquet", "scenario.yaml", "chamber.csv")
"""What imumon keeps in a session under names of its own; no output of a command may take their place."""


def bundled(kind: str) -> dict[str, Path]:
    """Return the files of a kind (devices, units, scenarios) that come with imumon, by their names."""
    packaged = Path(__file__).resolve().parent / "configs" / kind
    folder = packaged if packaged.is_dir() else packaged.parents[2] / "configs" / kind
    return {path.stem: path for path in folder.glob("*.yaml")}


def as_path(path: object) -> Path:
    """Return the argument `path` of a call; raises BAD_CONFIG for what is neither text nor a path."""
    if not isinstance(path, str | Path):
        raise bad_config(f"path={path!r:.60}: expected a path")
    return Path(path)


def read_text(path: Path, reason: Reason = Reason.BAD_CONFIG, hint: str = "") -> str:
    """Return the text of a file; raises an `ImumonError` of this reason when it is huge or unreadable."""
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_TEXT + 1)
        if len(content) > LARGEST_TEXT:
            raise ImumonError(
                reason,
                f"{path}: has more than {LARGEST_TEXT >> 20} MiB, so it is no file of settings",
                hint or "give another file",
            )
        return content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except OSError as error:
        raise ImumonError(reason, f"{path}: cannot be read: {error.strerror}", hint or UNREADABLE) from error
    except ValueError as error:  # no UTF-8, or a path that has a NUL character
        raise ImumonError(reason, f"{path}: cannot be read as text: {error}", hint) from error


@contextmanager
def readable(path: Path, hint: str = "") -> Iterator[None]:
    """Raise BAD_DATA, naming the file, where it cannot be read."""
    try:
        yield
    except OSError as error:
        raise bad_data(f"{path}: cannot be read: {error.strerror}", hint or UNREADABLE) from error


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let an OSError name this file, which is the one that a user knows, and not one on the way to it."""
    try:
        yield
    except OSError as error:
        why = os.strerror(error.errno) if error.errno else str(error)
        raise OSError(error.errno or errno.EIO, why, str(path)) from error


@contextmanager
def results_folder(path: Path) -> Iterator[None]:
    """Make a folder, if need be with its parents; those that are new and empty at the end go again.

    Raises OSError when that fails.
    """
    made = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        path.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        for folder in made:
            with suppress(OSError):  # it holds something, or is not there
                folder.rmdir()


def target(path: Path) -> Path:
    """Return the file that a path leads to: a link stays, and what it leads to is written."""
    return Path(os.path.realpath(path))  # Path.resolve raises for links in a circle


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a new file to write to, which takes the place of `path` at the end, and is removed with an error.

    Whoever reads gets the old file or the new one, never a part.

    Raises OSError when it cannot be written, naming `path`; a file that was there before is untouched.
    """
    place = target(path)
    partial = place.with_name(f"{place.name}.partial")
    with naming(path):
        try:
            yield partial
            with partial.open("rb") as file:
                os.fsync(file.fileno())  # or a power cut leaves the new name with nothing in it
            partial.replace(place)
        finally:
            partial.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a file as a whole or not at all; raises OSError, as `replacing`."""
    with replacing(path) as partial:
        partial.write_bytes(text.encode("utf-8"))


def write_png(path: Path, figure: Any, dpi: float) -> None:
    """Write a figure of matplotlib as a PNG, as a whole or not at all; raises OSError, as `replacing`."""
    with replacing(path) as partial:
        figure.savefig(partial, dpi=dpi, format="png")


def check_output(path: Path, *, replace: bool = False, suffix: str = "") -> None:
    """Refuse an output that cannot be a file, that would take the place of a file of a session, whoever reads
    it, or that is there already unless it may be replaced; and one without the suffix of what is written.

    Raises EXISTS or BAD_CONFIG.
    """
    place, hint = target(path), "nothing was overwritten; give another name"
    if str(path) == "-" or (path.exists() and not path.is_file()):
        what = "is a folder" if path.is_dir() else "is no file"
        raise bad_config(f"{path}: the output {what}", "give the name of a file to write")
    if not path.name.lower().endswith(suffix):
        raise bad_config(f"{path}: what is written ends in {suffix}", f"name it {path.stem}{suffix}")
    session = any((place.parent / name).exists() for name in TRUTH)
    if session and (place.name in TRUTH or (place.name in SESSION_FILES and place.exists())):
        raise ImumonError(
            Reason.EXISTS, f"{place.parent} is a session, whose {place.name} no output may be", hint
        )
    if path.exists() and not replace:
        raise ImumonError(Reason.EXISTS, f"{path} is there already", hint)
    if not place.parent.is_dir():
        raise bad_config(f"{path}: there is no folder {place.parent}", "make it first")


def check_outputs(plot: Path | None, *files: Path | None) -> None:
    """Refuse, as `check_output`, outputs of which only a picture replaces one; and one file for two of them.

    Raises EXISTS or BAD_CONFIG.
    """
    given = [*filter(None, (plot, *files))]
    for path in given:
        check_output(path, replace=path is plot, suffix=".png" if path is plot else "")
    if len({target(path) for path in given}) < len(given):
        names = ", ".join(map(str, given))
        raise bad_config(f"two of the outputs are the same file: {names}", "give each a name of its own")


def plain(value: Any) -> Any:
    """Return a value as JSON knows it: paths as text, numbers without the types of NumPy, NaN as None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value

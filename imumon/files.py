"""Text files read whole, or refused with the reason; files written whole or not at all; values for JSON."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from imumon.errors import ImumonError, Reason

LARGEST_TEXT = 16 << 20
"""Bytes: four for each character of the longest document."""


def bundled(kind: str) -> dict[str, Path]:
    """Return the files of a kind (devices, units, scenarios) that come with imumon, by their names."""
    packaged = Path(__file__).resolve().parent / "configs" / kind
    folder = packaged if packaged.is_dir() else packaged.parents[2] / "configs" / kind
    return {path.stem: path for path in folder.glob("*.yaml")}


def read_text(path: Path, reason: Reason = Reason.BAD_CONFIG, hint: str = "") -> str:
    """Return the text of a file; raises an `ImumonError` of this reason when it is huge or unreadable."""
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_TEXT + 1)
        if len(content) > LARGEST_TEXT:
            large = f"{path}: has more than {LARGEST_TEXT >> 20} MiB, so it is no file of settings"
            raise ImumonError(reason, large, hint or "give another file")
        return content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except OSError as error:
        raise ImumonError(reason, f"{path}: cannot be read: {error.strerror}", hint) from error
    except UnicodeDecodeError as error:
        raise ImumonError(reason, f"{path}: is not UTF-8 text (byte {error.start})", hint) from error
    except ValueError as error:
        raise ImumonError(reason, f"{str(path)!r} is no path: it has a NUL character", hint) from error


def write_text(path: Path, text: str) -> None:
    """Write a file; whoever reads sees the old one or the new one, never a part.

    Raises
    ------
    OSError
        When it cannot be written; a file that was there before is untouched.
    """
    _write_whole(path, text.encode("utf-8"))


def write_png(path: Path, figure: Any, dpi: float) -> None:
    """Write a figure of matplotlib as a PNG, as a whole or not at all.

    Raises
    ------
    ImumonError
        BAD_CONFIG when the file cannot be written.
    """
    picture = io.BytesIO()
    figure.savefig(picture, dpi=dpi, format="png")
    try:
        _write_whole(path, picture.getvalue())
    except OSError as error:
        raise ImumonError(Reason.BAD_CONFIG, f"{path}: cannot be written: {error.strerror}") from error


def _write_whole(path: Path, content: bytes) -> None:
    partial = path.with_name(f"{path.name}.partial")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())  # or a power cut leaves the new name with nothing in it
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def check_output(path: Path, *, replace: bool = False) -> None:
    """Refuse an output that has no folder, or that is there already unless it may be replaced.

    Raises
    ------
    ImumonError
        EXISTS or BAD_CONFIG.
    """
    if path.exists() and not replace:
        raise ImumonError(
            Reason.EXISTS, f"{path} is there already", "nothing was overwritten; give another name"
        )
    if not path.parent.is_dir():
        raise ImumonError(Reason.BAD_CONFIG, f"{path}: there is no folder {path.parent}", "make it first")


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

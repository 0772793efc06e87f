"""Where sessions of a batch are: in folders here, or at URLs that fsspec knows."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from imumon.errors import bad_config, bad_data, missing_package
from imumon.recordings.folder import METADATA_NAME, WIRE_NAME, Session, is_session, read_metadata


def find(place: str) -> list[str]:
    """Return the sessions at a place in order: itself, or all in the folders below.

    Raises BAD_DATA when there is none, or the place cannot be read; BAD_CONFIG when a package is missing.
    """
    found = _elsewhere(place) if "://" in place else _here(Path(place))
    if not found:
        raise bad_data(f"{place}: there is no session", "give sessions, or their folder")
    return found


@contextmanager
def fetched(place: str, folder: Path | None = None) -> Iterator[Path]:
    """Give the path of a session: where it is, or of a copy in a `folder` that is gone afterwards.

    Copied are its metadata and what everything else follows from; a recording of the view stays where it is.

    Raises BAD_DATA when it cannot be read.
    """
    if "://" not in place:
        yield Path(place)
        return
    files, path = _opened(place)
    with TemporaryDirectory(prefix="imumon-", dir=folder) as made:
        copy = Path(made) / Path(path).name
        try:
            copy.mkdir()
            files.get_file(f"{path}/{METADATA_NAME}", str(copy / METADATA_NAME))
            truth = Session(copy, read_metadata(copy / METADATA_NAME)).truth_path
            files.get_file(f"{path}/{truth.name}", str(truth))
        except OSError as error:
            raise bad_data(f"{place}: cannot be read: {error}") from error
        yield copy


def _here(path: Path) -> list[str]:
    if is_session(path):
        return [str(path.absolute())]
    # One whose session.yaml is lost is found by its bytes, to be reported.
    found = {each.parent for name in (METADATA_NAME, WIRE_NAME) for each in path.rglob(name)}
    return [str(each.absolute()) for each in sorted(found)]


def _elsewhere(place: str) -> list[str]:
    files, root = _opened(place)
    address, mark, options = place.partition("?")
    try:
        files.info(root)  # which reports why where there is nothing: the search below passes over errors
        parts = [str(name).rpartition("/") for name in files.find(root)]
    except OSError as error:
        raise bad_data(f"{place}: cannot be read: {error}") from error
    found = {folder for folder, _, name in parts if name in (METADATA_NAME, WIRE_NAME)}
    below = [folder[len(root) :] for folder in sorted(found)]
    return [f"{address.rstrip('/')}{rest}{mark}{options}" for rest in below]


def _opened(place: str) -> tuple[Any, str]:
    """Return the file system of a URL, and the path in it.

    S3 is read by Arrow, which is there anyway and takes the settings in the URL (``?region=...``) and those
    in the environment; everything else by what fsspec has for it.
    """
    try:
        from fsspec.core import url_to_fs
        from fsspec.implementations.arrow import ArrowFSWrapper
    except ImportError as error:
        raise missing_package("a session at a URL", "fsspec", "batch") from error
    from pyarrow import ArrowException
    from pyarrow.fs import FileSystem

    try:
        if place.startswith("s3://"):
            system, path = FileSystem.from_uri(place)
            return ArrowFSWrapper(system), str(path)
        files, path = url_to_fs(place)
    except (ImportError, ValueError, OSError, ArrowException) as error:
        raise bad_config(f"{place}: cannot be opened: {error}") from error
    return files, str(path)

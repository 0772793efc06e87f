"""The one error class of imumon, its reasons, and the exit codes they lead to."""

from enum import Enum

EXIT_OK = 0
"""The command did what was requested."""
EXIT_NEGATIVE = 1
"""The command ran, and the answer is no (a verification that differs, a heading that does not settle)."""
EXIT_USAGE = 2
"""Wrong command line, or a file written by a person (device, map, pipeline YAML) is wrong or not there."""
EXIT_PORT = 3
"""The port cannot be opened, was lost for good, or stayed silent."""
EXIT_DATA = 4
"""A recording, capture or table is not there, cannot be read, or holds nothing that can be decoded."""

EXIT_INTERRUPTED = 130
"""Ctrl-C before a recording began, or in a command that records nothing; as shells have it."""


class Reason(Enum):
    """Why an operation failed."""

    NOT_FOUND = "not found"
    """No such port, or it went away; no viewer; for `imumon.read` also no such file."""
    PERMISSION = "permission denied"
    """The port exists but this user may not open it."""
    BUSY = "busy"
    """Another program holds the port."""
    LOST = "lost"
    """The port was open and failed."""
    SILENT = "silent"
    """The port is open and nothing arrives."""
    WRONG_BAUD = "wrong baud rate or protocol"
    """Bytes arrive but do not frame."""
    BAD_CONFIG = "bad configuration"
    """An option is wrong, or a YAML file is wrong or not there."""
    BAD_DATA = "bad data"
    """A capture, table or recording is not there, or does not hold what it should."""
    REFUSED = "refused by the device"
    """The device answered, and refused, or did something else than was commanded."""
    TIMEOUT = "timeout"
    """It took longer than it was given."""
    EXISTS = "exists already"
    """The output is already there, and nothing is overwritten."""

    @property
    def exit_code(self) -> int:
        """Exit code of the command line for this reason."""
        codes = {
            Reason.BAD_CONFIG: EXIT_USAGE,
            Reason.EXISTS: EXIT_USAGE,
            Reason.REFUSED: EXIT_NEGATIVE,
            Reason.BAD_DATA: EXIT_DATA,
            Reason.TIMEOUT: EXIT_DATA,
        }
        return codes.get(self, EXIT_PORT)


class ImumonError(Exception):
    """An error that a user can act on: what is wrong, and what to do about it.

    "Raises BAD_DATA" in a docstring means this error with that reason.

    Parameters
    ----------
    reason : Reason
        Machine-readable cause; it decides the exit code.
    seen : str
        What was found, one sentence, with the numbers.
    hint : str
        What to do, one or a few lines; empty when there is nothing to advise.
    """

    def __init__(self, reason: Reason, seen: str, hint: str = "") -> None:
        super().__init__(seen if not hint else f"{seen}\n{hint}")
        self.reason = reason
        self.seen = seen
        self.hint = hint

    @property
    def line(self) -> str:
        """The whole message in one line, for a log."""
        return "; ".join(str(self).splitlines())


def bad_config(seen: str, hint: str = "") -> ImumonError:
    """Return the error of a wrong option, argument or file of settings."""
    return ImumonError(Reason.BAD_CONFIG, seen, hint)


def bad_data(seen: str, hint: str = "") -> ImumonError:
    """Return the error of a capture, table or recording that does not hold what it should."""
    return ImumonError(Reason.BAD_DATA, seen, hint)


def missing_package(what: str, package: str, extra: str) -> ImumonError:
    """Return the error of what needs a package that few need, with the extra of imumon that brings it."""
    return bad_config(f"{what} needs the package {package}", f'pip install "imumon[{extra}]"')

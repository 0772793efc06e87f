"""What is installed of other programs, and how a figure of theirs stands beside imumon's."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def named(package: str) -> str | None:
    """Return a package's name with its version; None where it is not installed."""
    try:
        return f"{package} {version(package)}"
    except PackageNotFoundError:
        return None


def faster(other: float, imumon: float) -> str:
    """Return who is faster, and how many times, from the times that both take."""
    if imumon <= other:
        return f"imumon {other / imumon:.3g} ×"
    return f"**the other {imumon / other:.3g} ×**"

"""Reads what the vendor's decoder got from the recorded frames."""

from __future__ import annotations

from pathlib import Path


def read_golden(path: Path) -> list[dict[str, dict[str, str]]]:
    """Return for each frame the items by name, each a mapping of key to text ("" where there is no key)."""
    frames: list[dict[str, dict[str, str]]] = [{}]
    item: dict[str, str] = {}
    for line in path.read_text(encoding="ascii").splitlines():
        if not line:
            frames.append({})
        elif not line.startswith(" "):
            item = frames[-1].setdefault(line.rstrip(":"), {})
        else:
            key, _, value = (
                line.strip().rpartition(":") if line.strip()[0].isalpha() else ("", "", line.strip())
            )
            item[key] = value
    return [frame for frame in frames if frame]

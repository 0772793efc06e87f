"""The Rerun viewer as a program: where it is, whether it can show, how it is started, whether it answers."""

import contextlib
import http.client
import os
import secrets
import socket
import subprocess
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from imumon.errors import ImumonError, Reason

Mode = Literal["native", "web"]

LOCALHOST = "127.0.0.1"
VIEWER_PORT = 9876
"""Where Rerun viewers listen, unless set otherwise."""
WEB_PORT = 9090
VIEWER_MEMORY = "2GB"
"""Above this the viewer forgets the oldest data, so that a session may last for days."""
SERVER_MEMORY, PAGE_MEMORY = "256MB", "110MB"
"""What a server keeps for viewers that come later, and for pages.  All estimators make 0.30 MB/s at 100 Hz,
0.13 to 0.15 MB/s at any rate as a page gets it.  Pages took in 120 MB; from 156 MB on most hung, at 5 GB."""

LIVE_APPLICATION, APPLICATION = "imumon-live", "imumon"
"""Of live views and of recordings: a viewer keeps an arrangement for each."""


def has_display() -> bool:
    """Return whether a window can be opened here."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def viewer_binary() -> Path:
    """Return the viewer's executable itself; the `rerun` on the path is a script that would stay in between.

    Raises NOT_FOUND when this installation has none.
    """
    spec = find_spec("rerun_cli")
    for folder in (spec.submodule_search_locations if spec else None) or ():
        if (path := Path(folder, "rerun")).is_file():
            return path
    raise ImumonError(
        Reason.NOT_FOUND, "the Rerun viewer is not installed", "pip install 'rerun-sdk', or use --view none"
    )


def quiet_environment() -> dict[str, str]:
    """Return the environment for Rerun's programs: no analytics, warnings only.

    Rerun 0.41 knows no variable of its own for this.  With ``CI`` set it neither reads nor writes its
    analytics files and starts no session, unless ``FORCE_RERUN_ANALYTICS`` is set.
    """
    environment = {"RUST_LOG": "warn", **os.environ, "CI": "1"}
    environment.pop("FORCE_RERUN_ANALYTICS", None)
    return environment


def probe(port: int, timeout_s: float = 0.5) -> bool | None:
    """Return whether a Rerun viewer or server is behind a port of this machine; None when nothing listens.

    An unknown method of a gRPC service is refused with ``grpc-status``; a stopped process accepts the
    connection (the kernel does) and is silent.
    """
    connection = http.client.HTTPConnection(LOCALHOST, port, timeout=timeout_s)
    try:
        connection.request("POST", "/imumon/probe", headers={"Content-Type": "application/grpc-web+proto"})
        return connection.getresponse().getheader("grpc-status") is not None
    except (TimeoutError, http.client.HTTPException):
        return False
    except OSError:
        return None
    finally:
        connection.close()


def free_port(preferred: int, bind: str = LOCALHOST) -> int:
    """Return the preferred port or the next one that is free.

    Another program may take it before the caller does.

    Raises BUSY when the next hundred are all in use.
    """
    for port in range(preferred, min(preferred + 100, 65536)):
        with contextlib.suppress(OSError), socket.create_server((bind, port)):
            return port
    raise ImumonError(Reason.BUSY, f"no free port from {preferred} on {bind}", "name another port")


def start_quietly(command: Sequence[str], *, own_session: bool = True) -> subprocess.Popen[bytes]:
    """Start one of Rerun's programs without input, output and analytics."""
    return subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=quiet_environment(),
        start_new_session=own_session,
    )


def start_viewer(port: int, *arguments: str) -> subprocess.Popen[bytes]:
    """Start a native viewer that listens on 127.0.0.1; it outlives this program.

    Where one listens on the port already, the program that is started passes its source on to that one.
    """
    return start_quietly(
        [
            str(viewer_binary()),
            f"--port={port}",
            f"--bind={LOCALHOST}",
            "--hide-welcome-screen",
            f"--memory-limit={VIEWER_MEMORY}",
            f"--server-memory-limit={SERVER_MEMORY}",
            *arguments,
        ]
    )


def viewer_port(preferred: int = VIEWER_PORT) -> int:
    """Return the port of the viewer that is open, or one on which a new one can listen."""
    return free_port(preferred + 1) if probe(preferred) is False else preferred


def hidden_address() -> tuple[str, int]:
    """Return an address of the loopback and a free port there, both drawn at random.

    Rerun's server answers whoever reaches its port: a page of another site must not find it.
    """
    address = "127." + ".".join(str(1 + secrets.randbelow(254)) for _ in range(3))
    return address, free_port(20000 + secrets.randbelow(20000), address)


def proxy_url(port: int, address: str = LOCALHOST) -> str:
    """Return the address of the stream on this port."""
    return f"rerun+http://{address}:{port}/proxy"

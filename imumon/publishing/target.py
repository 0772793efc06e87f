"""Where live samples are published: what kind of receiver, and at which address."""

import importlib.util
import ipaddress
import socket
from typing import Literal, NamedTuple
from urllib.parse import urlsplit

from imumon.errors import bad_config, missing_package
from imumon.view.viewer import LOCALHOST

Kind = Literal["udp-json", "foxglove", "ros2"]
PORTS: dict[Kind, int] = {"udp-json": 9870, "foxglove": 8765, "ros2": 0}
"""What PlotJuggler and Foxglove propose; ROS finds its readers by itself."""
NETWORK = "network"
"""Instead of an address for ROS 2: as far as the environment allows, not this computer alone."""


class Target(NamedTuple):
    """A kind of receiver, and where: for UDP where datagrams go, for Foxglove where the server listens."""

    kind: Kind
    host: str = LOCALHOST
    port: int = 0

    def __str__(self) -> str:
        """Return what `parse_target` reads."""
        if self.kind == "ros2":
            return self.kind if self.is_local else f"{self.kind}={NETWORK}"
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.kind}={host}:{self.port}"

    @property
    def is_local(self) -> bool:
        """Whether nothing leaves this computer."""
        return self.host != NETWORK and ipaddress.ip_address(self.host).is_loopback

    @property
    def warning(self) -> str | None:
        """What a person must know before it begins; None where nothing leaves this computer."""
        if self.is_local:
            return None
        if self.kind == "udp-json":
            return f"--publish {self}: the measurements go to {self.host}, for all on the way to read"
        return f"--publish {self}: every computer that reaches this one can read the measurements"


def parse_target(text: str) -> Target:
    """Return the target that ``KIND`` or ``KIND=HOST[:PORT]`` names; without an address nothing leaves here.

    Raises BAD_CONFIG when it cannot be read, the host is not known, or a package is missing.
    """
    name, _, address = text.partition("=")
    kind = next((one for one in PORTS if one == name), None)
    if kind is None:
        raise bad_config(f"--publish {text}: there is no {name!r}", f"one of: {', '.join(PORTS)}")
    if kind == "foxglove" and importlib.util.find_spec("foxglove") is None:
        raise missing_package("--publish foxglove", "foxglove-sdk", "foxglove")
    if kind == "ros2":
        if importlib.util.find_spec("rclpy") is None:
            raise bad_config(
                "--publish ros2 needs rclpy, which comes with ROS 2 and with no package index",
                "source /opt/ros/DISTRO/setup.bash, then start imumon with the Python that ROS was built for",
            )
        if address not in ("", NETWORK):
            raise bad_config(
                f"--publish {text}: ROS 2 takes no address",
                f"ros2 for this computer alone, ros2={NETWORK} for as far as ROS is set up to reach",
            )
        return Target(kind, NETWORK if address else LOCALHOST)
    hint = f"{kind}=:PORT, {kind}=HOST:PORT or {kind}=[HOST]:PORT, with 1 to 65535"
    try:
        parts = urlsplit(f"//{address}")
        port = PORTS[kind] if parts.port is None else parts.port
        is_more = parts.netloc != address or "@" in address or "%" in address
        if is_more or port == 0 or (parts.hostname or "").isdigit():
            raise ValueError(f"{address} is no host and port")
        # Once: a name server must not be waited for later on.
        found = socket.getaddrinfo(parts.hostname or LOCALHOST, port, type=socket.SOCK_DGRAM)
    except (OSError, ValueError) as error:
        raise bad_config(f"--publish {text}: {error}", hint) from error
    return Target(kind, str(found[0][4][0]).partition("%")[0], port)

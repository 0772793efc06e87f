"""How a port is opened: its URL and the shape of a character on the line."""

from dataclasses import dataclass

from imumon.errors import bad_config


@dataclass(frozen=True)
class PortSettings:
    """Where the bytes come from and how the line is set; raises BAD_CONFIG when a value cannot be.

    `url` is a device (``/dev/ttyUSB0``) or ``socket://host:port``, which has no line: nothing else matters
    there.  Baud rate in bit/s; 7 or 8 data bits; parity N, E or O; 1 or 2 stop bits.
    """

    url: str
    baudrate: int = 115200
    bytesize: int = 8
    parity: str = "N"
    stopbits: int = 1

    def __post_init__(self) -> None:
        if not self.url:
            raise bad_config("the name of the port is empty", "imumon ports lists the ports")
        if not self.url.isprintable():
            raise bad_config(f"the name of the port is not plain text: {self.url!a}", "link to it")
        if self.baudrate <= 0:
            raise bad_config(f"baud rate must be positive, got {self.baudrate}")

    @property
    def has_line(self) -> bool:
        """Whether there is a line with a baud rate, as there is none behind a ``socket://``."""
        return "://" not in self.url

    @property
    def capacity_bytes_per_s(self) -> float | None:
        """Bytes per second that the line can carry, or None when there is no line."""
        bits = 1 + self.bytesize + (self.parity != "N") + self.stopbits  # the first is the start bit
        return self.baudrate / bits if self.has_line else None

    def __str__(self) -> str:
        if not self.has_line:
            return self.url
        return f"{self.url} at {self.baudrate} {self.bytesize}{self.parity}{self.stopbits}"

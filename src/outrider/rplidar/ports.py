"""Serial ports: which of them may be a lidar, and one opened, with what goes wrong said in one line."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import serial
from serial.tools import list_ports

try:
    from termios import error as _Termios
except ImportError:  # there is none on Windows
    _Termios = OSError  # type: ignore[assignment,misc]

AUTO = "auto"
ERRORS = (OSError, _Termios)  # what using a port raises once it is gone
# USB bridges that the maker, or a maker of adapters, puts between lidar and plug: vendor, product.
BRIDGES = {
    (0x10C4, 0xEA60): "CP210x",
    (0x1A86, 0x7523): "CH340",
    (0x1A86, 0x55D3): "CH343",
    (0x1A86, 0x55D4): "CH9102",
    (0x0403, 0x6001): "FT232",
    (0x0403, 0x6015): "FT-X",
}


class Setback(Exception):
    """What keeps the sensor from working now, in one line; it may pass, and is tried again."""


class Listed(NamedTuple):
    """A serial port of this computer."""

    device: str  # path or name
    usb: tuple[int, int] | None  # vendor, product; None where it is not on USB
    product: str  # what it calls itself

    def __str__(self) -> str:
        return f"{self.device} ({BRIDGES.get(self.usb or (0, 0)) or self.product or 'not on USB'})"


Listing = Callable[[], Iterable[Listed]]


def listed() -> list[Listed]:
    """All serial ports the computer knows of; pseudo-terminals are not among them."""
    return [
        Listed(p.device, None if p.vid is None else (p.vid, p.pid), p.product or p.description or "")
        for p in list_ports.comports()
    ]


def candidates(listing: Listing) -> list[str]:
    """Ports that may be a lidar, the likeliest first; others are never written to.

    Raises Setback, with what was looked at, where there is none.
    """
    ports = sorted(listing())
    order = list(BRIDGES)
    likely = sorted((p for p in ports if p.usb in BRIDGES), key=lambda p: order.index(p.usb or (0, 0)))
    if not likely:
        seen = "no serial port at all" if not ports else f"only {', '.join(map(str, ports))}"
        chips = ", ".join(BRIDGES.values())
        raise Setback(
            f"no lidar found: looked for a USB bridge ({chips}), saw {seen}; plug it in or name its port"
        )
    return [p.device for p in likely]


def opened(port: str, baud: int) -> serial.Serial:
    """The port, raw, for this program alone; its DTR is set, which keeps the motor of an A1 at rest.

    Raises Setback that says why it cannot be used and what to do.
    """
    line = serial.Serial(baudrate=baud, timeout=0.05, write_timeout=0.5, exclusive=os.name == "posix" or None)
    line.port, line.dtr = port, True
    try:
        line.open()
    except (*ERRORS, ValueError) as error:
        raise Setback(refused(port, error)) from error
    return line


def refused(port: str, error: BaseException) -> str:
    """Why a port could not be opened and what to do about it, in one line."""
    code = getattr(error.__context__, "errno", None) or getattr(error, "errno", None)
    if isinstance(error.__context__, _Termios) or Path(port).is_dir():
        code = errno.ENOTTY
    if code == errno.EACCES:
        group = _group(port)
        return f"{port}: permission denied; join its group (sudo usermod -aG {group} $USER) and log in again"
    if code in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return f"{port}: no such port; plug the lidar in or name another port"
    if code in (errno.EBUSY, errno.EAGAIN) or "lock" in str(error):
        return f"{port}: in use by another program; close that one"
    if code == errno.ENOTTY:
        return f"{port}: not a serial port; name the one the lidar is on"
    return f"{port}: cannot be opened ({' '.join(str(error).split())})"


def _group(port: str) -> str:
    """Name of the group that may use a port; dialout where it cannot be told or nobody joins it."""
    with suppress(OSError, KeyError, ImportError):
        import grp

        name = grp.getgrgid(Path(port).stat().st_gid).gr_name
        return "dialout" if name in ("root", "tty") else name
    return "dialout"


def set_dtr(line: serial.Serial, on: bool) -> None:
    """Set or clear DTR where the line has one; a pseudo-terminal has none."""
    with suppress(OSError):
        line.dtr = on


def close(line: serial.Serial) -> None:
    """Free the port; DTR stays as it is where it can, else the motor of an A1 would start now."""
    with suppress(ImportError, *ERRORS):
        import termios

        attributes = termios.tcgetattr(line.fileno())
        attributes[2] &= ~termios.HUPCL
        termios.tcsetattr(line.fileno(), termios.TCSANOW, attributes)
    with suppress(*ERRORS):
        line.close()

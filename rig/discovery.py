"""Discovery of devices on serial ports: candidates by USB ids, and identification by query.

Listing opens nothing and writes nothing. Probing opens the port that it is given and asks as the drivers do.

USB ids: a maker's own say who it is; those of a maker of USB chips say only which chip is in the cable.
Source: Linux kernel, drivers/usb/serial/ftdi_sio_ids.h (Newport 104d), the list of USB ids at linux-usb.org (Zaber
2939, Arduino 2341 and 2a03, WCH 1a86, Silicon Labs 10c4), Thorlabs APT protocol manual (0403:faf0).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from anisoscope.base.errors import AnisoscopeError, NotConnected, RigFileError
from anisoscope.base.plugins import installed
from anisoscope.rig.drivers import LIGHTS, STAGES, open_light, open_stage
from anisoscope.rig.rigfile import BY_HAND
from anisoscope.rig.transport import Transport

FTDI, NEWPORT, ZABER, SILABS, WCH = 0x0403, 0x104D, 0x2939, 0x10C4, 0x1A86
ARDUINOS = frozenset({0x2341, 0x2A03})
BY_USB_ID: dict[tuple[int, int], tuple[str, ...]] = {
    (FTDI, 0xFAF0): ("apt",),
    (FTDI, 0x6015): ("elliptec", "grbl", "serial"),
    (FTDI, 0x6001): ("zaber", "smc100", "elliptec", "grbl", "serial"),
    (FTDI, 0x6011): ("zaber",),
    (SILABS, 0xEA60): ("grbl", "serial", "zaber"),
    (WCH, 0x7523): ("grbl", "serial"),
}
BY_MAKER: dict[int, tuple[str, ...]] = {
    NEWPORT: ("smc100",),
    ZABER: ("zaber",),
    **dict.fromkeys(ARDUINOS, ("grbl", "serial")),
}
BY_WORD: dict[str, tuple[str, ...]] = {
    "thorlabs": ("apt", "elliptec"),
    "kinesis": ("apt",),
    "zaber": ("zaber",),
    "newport": ("smc100",),
    "conex": ("smc100",),
}


@dataclass(frozen=True)
class FoundPort:
    """A serial port of this machine, as the operating system describes it.

    Attributes:
        port: what goes into the rig file.
        description: what the system calls it.
        usb: vendor and product id such as ``0403:faf0``; "" for a port that is not on USB.
        maker, product, serial: as the device says; "" where it does not.
        may_be: drivers of devices that have such a port, likeliest first; empty if nothing is known.
    """

    port: str
    description: str
    usb: str
    maker: str
    product: str
    serial: str
    may_be: tuple[str, ...]


@dataclass(frozen=True)
class Answer:
    """Result of probing a port: the driver that found its device, with the device's name; or why none did."""

    driver: str = ""
    device: str = ""
    problem: str = ""


def find_ports() -> tuple[FoundPort, ...]:
    """The serial ports of this machine in order of name; none is opened."""
    return tuple(_describe(port) for port in sorted(list_ports.comports(), key=lambda port: port.device))


def _describe(port: ListPortInfo) -> FoundPort:
    known = port.vid is not None and port.pid is not None
    maker, product = port.manufacturer or "", port.product or ""
    description = port.description or ""
    return FoundPort(
        port=port.device,
        description="" if description == "n/a" else description,
        usb=f"{port.vid:04x}:{port.pid:04x}" if known else "",
        maker=maker,
        product=product,
        serial=port.serial_number or "",
        may_be=candidates(port.vid, port.pid, f"{maker} {product} {description}"),
    )


def candidates(vendor: int | None, product: int | None, words: str = "") -> tuple[str, ...]:
    """Drivers of devices that may have a port of these USB ids, likeliest first.

    Args:
        vendor: USB vendor id, if the port has one.
        product: USB product id, if the port has one.
        words: what the device says of itself; a maker's name in it leads.
    """
    found = [name for word, names in BY_WORD.items() if word in words.lower() for name in names]
    if vendor is not None and product is not None:
        found += BY_USB_ID.get((vendor, product), ())
        found += BY_MAKER.get(vendor, ())
    return tuple(dict.fromkeys(found))


def probe(port: str, may_be: tuple[str, ...] = ()) -> Answer:
    """Identify the device on a port with each driver in turn; nothing moves.

    Opening resets some boards (an Arduino loses its position). Devices at another bus address than their
    driver's first are not found.

    Args:
        port: the port.
        may_be: drivers to try, in this order; empty tries every stage.
    """
    stages = [name for name in installed(STAGES) if name != BY_HAND]
    drivers = [name for name in may_be if name in stages or name in installed(LIGHTS)] or stages
    try:
        Transport(port).close()
    except NotConnected as error:
        return Answer(problem=str(error))
    answer, silent = _ask(port, drivers, stages)
    if silent and answer.problem:
        # what came may be the late answer to a driver that had given up: a busy computer, a slow adapter
        second, _ = _ask(port, silent, stages)
        answer = second if second.driver else answer
    return (
        answer
        if answer.driver or answer.problem
        else Answer(problem=f"nobody answered as {', '.join(drivers)} does")
    )


def _ask(port: str, drivers: Sequence[str], stages: Collection[str]) -> tuple[Answer, list[str]]:
    """The answer to the first driver that knows its device, or what went wrong; and the drivers that heard nothing."""
    silent: list[str] = []
    problem = ""
    for name in drivers:
        try:
            return Answer(name, _identify(name, port, is_stage=name in stages)), silent
        except (NotConnected, RigFileError):  # silent; or a driver that needs more than a port
            silent.append(name)
        except AnisoscopeError as error:
            problem = f"something answered, but not as {name} does: {error}"
    return Answer(problem=problem), silent


def _identify(name: str, port: str, *, is_stage: bool) -> str:
    if is_stage:
        stage = open_stage(name, port=port)
        try:
            return stage.name
        finally:
            stage.close()
    light = open_light(name, port=port)
    light.close()
    return str(getattr(light, "name", "light"))

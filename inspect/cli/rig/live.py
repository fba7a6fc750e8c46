"""``anisoscope rig live``: the picture while a rig is set up, as numbers in the terminal or as a page in a browser."""

import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import decimal, message
from anisoscope.cli.json_output import print_json_line
from anisoscope.cli.options import Json
from anisoscope.cli.rig.options import Exposure, Gain, LightState, RigPath, write_line

if TYPE_CHECKING:
    from anisoscope.live_view.page import LivePage
    from anisoscope.live_view.view import Counts, FocusMeasure, Reading
    from anisoscope.rig.camera import Camera, CameraInfo

    Sink = Callable[[Counts, CameraInfo, Reading], None]

BLOCKS = " ▁▂▃▄▅▆▇█"
BAR = 30


def live(
    *,
    rig: RigPath,
    exposure: Exposure,
    gain: Gain = 1.0,
    light: LightState = "on",
    focus: Annotated[Literal["tenengrad", "laplacian"], Parameter(help="Focus measure.")] = "tenengrad",
    frames: Annotated[int | None, Parameter(name="--count", help="End after so many frames.")] = None,
    fps: Annotated[float, Parameter(help="Frames per second at most.")] = 10.0,
    web: Annotated[bool, Parameter(negative="", help="Show the picture on a page for the browser.")] = False,
    port: Annotated[
        int, Parameter(name="--web-port", help="With --web: TCP port of 127.0.0.1; 0 takes any free one.")
    ] = 0,
    json_: Json = False,
) -> int:
    """Show focus (of the best seen), saturation, mean, histogram and ridge direction, until Ctrl-C or q and Enter.

    The port of the stage stays free: move it from another terminal. The light goes off at the end. With --web
    the first line is the address to open; it works on this machine only and holds a secret key.

    Examples:
        anisoscope rig live --rig rig.toml --exposure 0.003
        anisoscope rig live --rig rig.toml --exposure 0.003 --web
    """
    from anisoscope.rig.acquisition.opening import open_devices
    from anisoscope.rig.rigfile import read_rig

    if frames is not None and frames < 1:
        raise UsageError(f"--count must be 1 or more, not {frames}")
    if not 0.0 < fps <= 1000.0:
        raise UsageError(f"--fps must lie above 0 and up to 1000, not {fps:g}")
    file = read_rig(rig)
    with open_devices({}, file.camera, None if light == "as-is" else file.light) as devices:
        camera, lamp = devices.camera, devices.light
        assert camera is not None
        camera.configure(exposure, gain)
        if lamp is not None:
            (lamp.on if light == "on" else lamp.off)()
        by_hand = lamp is not None and file.light.driver == "manual"  # which asks in the same terminal
        try:
            with _sinks(web, port, file.name, json_=json_) as sinks:
                _watch(camera, sinks, focus, frames, 1.0 / fps, end_request(listen=not by_hand))
        except KeyboardInterrupt:
            return 0
    return 0


def _watch(
    camera: "Camera",
    sinks: "list[Sink]",
    focus: "FocusMeasure",
    frames: int | None,
    pause_s: float,
    ended: threading.Event,
) -> None:
    from anisoscope.live_view.view import Meter, look_at

    meter, info = Meter(), camera.info
    while not ended.is_set():
        started = time.monotonic()
        counts = camera.grab()
        reading = meter.read(look_at(counts, info, focus=focus), time.monotonic())
        for sink in sinks:
            sink(counts, info, reading)
        if frames is not None and reading.frame >= frames:
            return
        ended.wait(max(0.0, pause_s - (time.monotonic() - started)))


def end_request(*, listen: bool) -> threading.Event:
    """Event set when q and Enter are typed in the terminal; never set without one, or if `listen` is False."""
    ended = threading.Event()
    if not listen or sys.stdin is None or not sys.stdin.isatty():
        return ended
    descriptor = sys.stdin.fileno()

    def wait_for_q() -> None:
        # The descriptor, not the stream: a thread that waits in the stream would hold its lock when Python ends.
        while line := os.read(descriptor, 64):
            if line.strip().lower() == b"q":
                ended.set()
                return

    threading.Thread(target=wait_for_q, name="wait for q", daemon=True).start()
    return ended


@contextmanager
def _sinks(web: bool, port: int, title: str, *, json_: bool) -> "Iterator[list[Sink]]":
    with ExitStack() as stack:
        if web:
            from anisoscope.live_view.page import LivePage

            page = stack.enter_context(LivePage(port, f"{title} – live"))
            print(message("live picture at {path}", path=page.address), flush=True)  # noqa: T201
            write_line(message("Ctrl-C ends it"))
            yield [_to_page(page)]
        elif json_:
            yield [_json_line]
        elif sys.stdout.isatty():
            from rich.live import Live

            screen = stack.enter_context(Live(auto_refresh=False, transient=False))
            yield [_to_screen(screen)]
        else:
            yield [lambda _counts, _info, reading: print(plain(reading), flush=True)]  # noqa: T201


def _to_page(page: "LivePage") -> "Sink":
    from anisoscope.live_view.picture import as_jpeg, draw

    def show(counts: "Counts", info: "CameraInfo", reading: "Reading") -> None:
        page.publish(as_jpeg(draw(counts, info, reading.view, reading.relative_focus)), numbers(reading))

    return show


def _json_line(_counts: "Counts", _info: "CameraInfo", reading: "Reading") -> None:
    print_json_line(numbers(reading))


def _to_screen(screen: Any) -> "Sink":  # noqa: ANN401 - rich's Live
    from rich.text import Text

    def show(_counts: "Counts", _info: "CameraInfo", reading: "Reading") -> None:
        screen.update(Text(panel(reading)), refresh=True)

    return show


def numbers(reading: "Reading") -> dict[str, Any]:
    """A reading as plain values."""
    view = reading.view
    return {
        "frame": reading.frame,
        "frames_per_s": reading.frames_per_s,
        "mean": view.mean,
        "saturated_share": view.saturated_share,
        "focus": view.focus,
        "relative_focus": reading.relative_focus,
        "ridge_deg": view.ridge_deg,
        "prominence": view.prominence,
        "histogram": list(view.histogram),
    }


def plain(reading: "Reading") -> str:
    """A reading as one line."""
    view = reading.view
    ridges = message("undefined") if view.ridge_deg is None else decimal(f"{view.ridge_deg:+.1f}°")
    words = [
        message("frame {number}", number=reading.frame),
        message("focus {share} of best", share=_focus(reading.relative_focus)),
        message("mean {share}", share=f"{view.mean:.1%}"),
        message("saturated {share}", share=f"{view.saturated_share:.2%}"),
        message("ridges {angle}", angle=ridges),
        blocks(view.histogram),
        _speed(reading.frames_per_s),
    ]
    return "  ".join(words)


def panel(reading: "Reading") -> str:
    """A reading as some lines for the terminal."""
    view = reading.view
    known = 0.0 if math.isnan(reading.relative_focus) else reading.relative_focus
    filled = round(BAR * known)
    bar = f"{'█' * filled}{'·' * (BAR - filled)}"
    ridges = (
        message("undefined")
        if view.ridge_deg is None
        else message("{angle}° counter-clockwise from upright", angle=f"{view.ridge_deg:+.1f}")
    )
    ends = message("q and Enter, or Ctrl-C, ends it")
    rows = (
        (
            message("focus"),
            f"{bar} {message('{share} of the best seen', share=_focus(reading.relative_focus))}",
        ),
        (message("saturated"), message("{share} of the pixels", share=f"{view.saturated_share:.2%}")),
        (message("mean"), message("{share} of full scale", share=f"{view.mean:.1%}")),
        (message("histogram"), f"{blocks(view.histogram)} ({message('black to full scale')})"),
        (message("ridges"), ridges),
        (message("frame"), f"{reading.frame}, {_speed(reading.frames_per_s)}; {ends}"),
    )
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {text}" for name, text in rows)


def blocks(histogram: tuple[float, ...]) -> str:
    """A histogram as a row of blocks, by the square root of the share so that small shares show."""
    top = max(histogram)
    if top <= 0.0:
        return BLOCKS[0] * len(histogram)
    return "".join(BLOCKS[math.ceil((len(BLOCKS) - 1) * math.sqrt(share / top))] for share in histogram)


def _focus(share: float) -> str:
    return message("too dark") if math.isnan(share) else f"{share:.0%}"


def _speed(frames_per_s: float) -> str:
    return "" if math.isnan(frames_per_s) else message("{rate} frames/s", rate=f"{frames_per_s:.1f}")

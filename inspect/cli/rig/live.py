"""``anisoscope rig live``: the picture while a rig is set up, as numbers in the terminal or as a page in a browser."""

import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from anisoscope.base.errors import RigError, UsageError
from anisoscope.base.language import decimal, message, per_cent, translated
from anisoscope.cli.help_page import MORE
from anisoscope.cli.json_output import print_json_line
from anisoscope.cli.log import chosen_language
from anisoscope.cli.options import Flag, Json, extra_packages
from anisoscope.cli.rig.options import OF_SHOT, RigPath, Yes, asking, write_line
from anisoscope.parameters.taking import Shot, Watching
from anisoscope.views.options import Given, Options, with_options

if TYPE_CHECKING:
    from anisoscope.live_view.lamps import Lamp, RigLamps
    from anisoscope.live_view.view import Counts, Reading
    from anisoscope.rig.camera import Camera, CameraInfo
    from anisoscope.rig.jogging import Gamepad, Jogger
    from anisoscope.rig.stage import RotationStage

    Sink = Callable[[Counts, CameraInfo, Reading], None]

BLOCKS = " ▁▂▃▄▅▆▇█"
BAR = 30


@Parameter(name="*")
@dataclass(frozen=True)
class Hands:
    """Page and jogging.

    Attributes:
        web: Show the picture on a page of the console, in the browser.
        jog: Move the axes by keys, here or on the page, and by --pad.
        pad: With --jog: game pad, such as /dev/input/event5; auto takes the only one (Linux).
        port: With --web: TCP port of 127.0.0.1; 0 takes any free one.
    """

    web: Flag = False
    jog: Flag = False
    pad: Path | None = None
    port: Annotated[int, Parameter(name="--web-port", group=MORE)] = 0


HANDS = Hands()


@with_options(
    shot=OF_SHOT,
    watching=Options(
        Watching,
        names={"frames": "--count"},
        groups=dict.fromkeys(("focus", "frames", "fps"), MORE),
        whole=True,
    ),
)
def live(
    *,
    rig: RigPath,
    shot: Given[Shot],
    watching: Given[Watching],
    hands: Hands = HANDS,
    yes: Yes = False,
    json_: Json = False,
) -> int:
    """Show focus (of the best seen), saturation, mean, histogram and ridge direction, until Ctrl-C or q and Enter.

    The port of the stage stays free: move it from another terminal; or with --jog by keys: arrows for stage and tilt,
    page up and down for z, a d w s for x and y, + and - for the size of the step, space stops all axes. A stick of a
    game pad steps its axis while it is held; shoulder buttons change the step, all others stop. The light goes off at
    the end. With --web the first line is the address to open, for browsers of this computer (extra [console]).

    Examples:
        anisoscope rig live --rig rig.toml --exposure 0.003
        anisoscope rig live --rig rig.toml --exposure 0.003 --web
        anisoscope rig live --rig rig.toml --exposure 0.003 --jog --pad auto --yes
    """
    from anisoscope.live_view.lamps import RigLamps
    from anisoscope.operations.rigging import home_axes
    from anisoscope.rig.acquisition.opening import open_devices
    from anisoscope.rig.rigfile import BY_HAND, read_rig

    seen, how = shot.made(), watching.made()
    if hands.pad is not None and not hands.jog:
        raise UsageError("--pad moves axes: it goes with --jog")
    if hands.web and (json_ or how.frames is not None):
        raise UsageError("--count and --json are of the lines in the terminal: not with --web")
    file = read_rig(rig, channel=seen.channel)
    axes = {name: part for name, part in file.axes.items() if hands.jog and part.driver != BY_HAND}
    lit = None if seen.light == "as-is" else file.light
    with open_devices(axes, file.camera, lit, rows_of=file) as devices:
        camera, lamp = devices.camera, devices.light
        assert camera is not None
        camera.configure(seen.exposure_s, seen.gain)
        if lamp is not None:
            (lamp.on if seen.light == "on" else lamp.off)()
        by_hand = lamp is not None and file.light.driver == "manual"  # which asks in the same terminal
        home_axes(devices.axes, axes, file, asking(rig, yes=yes))
        try:
            with ExitStack() as stack:
                jogger, ended = _jogging(devices.axes, hands.pad, stack) if hands.jog else (None, None)
                ended = ended or end_request(listen=not by_hand)
                lamps = RigLamps(rig)
                if hands.web:
                    _serve(camera, seen, how, lamps, hands.port, file.name, jogger, ended)
                else:
                    sink = stack.enter_context(_sink(jogger, json_=json_))
                    exposed = seen.exposure_s, seen.gain
                    _watch(
                        camera,
                        sink,
                        lambda counts, info, at_s: lamps.read(counts, info, exposed, at_s, seen.channel),
                        how,
                        ended,
                    )
        except KeyboardInterrupt:
            return 0
    return 0


def _jogging(
    axes: "dict[str, RotationStage]", pad: Path | None, stack: ExitStack
) -> "tuple[Jogger, threading.Event]":
    """Jogging by the keys of the terminal and a game pad; the event is set when q is pressed."""
    from anisoscope.rig.jogging import Gamepad, Jogger

    ended = threading.Event()
    pads = [] if pad is None else [Gamepad.find() if str(pad) == "auto" else Gamepad(pad)]
    for one in pads:
        stack.callback(one.close)
    jogger = stack.enter_context(Jogger(axes))

    def follow(one: "Gamepad") -> None:
        try:
            for command in one.commands(ended):
                jogger.do(command)
        except RigError as problem:
            write_line(str(problem))

    threads = [threading.Thread(target=follow, args=(one,), name="game pad", daemon=True) for one in pads]
    for thread in threads:
        thread.start()
        stack.callback(thread.join)
    stack.callback(ended.set)
    _listen_to_keys(jogger, ended, stack)
    return jogger, ended


def _listen_to_keys(jogger: "Jogger", ended: threading.Event, stack: ExitStack) -> None:
    """Take keys without Enter, where there is a terminal that can; it is set back at the end."""
    from anisoscope.rig.jogging import commands_of

    try:
        import termios
        import tty
    except ImportError:  # Windows: keys of the page and the game pad remain
        return
    if sys.stdin is None or not sys.stdin.isatty():
        return
    descriptor = sys.stdin.fileno()
    before = termios.tcgetattr(descriptor)
    stack.callback(termios.tcsetattr, descriptor, termios.TCSADRAIN, before)
    tty.setcbreak(descriptor)

    def take() -> None:
        while not ended.is_set() and (data := os.read(descriptor, 64)):
            for command in commands_of(data):
                jogger.do(command)
            if b"q" in data:
                ended.set()

    threading.Thread(target=take, name="keys", daemon=True).start()


def _watch(
    camera: "Camera",
    sink: "Sink",
    lamps: "Callable[[Counts, CameraInfo, float], tuple[Lamp, ...]]",
    how: Watching,
    ended: threading.Event,
) -> None:
    from anisoscope.live_view.view import Meter, look_at

    meter, info = Meter(), camera.info
    while not ended.is_set():
        started = time.monotonic()
        counts = camera.grab()
        read = lamps(counts, info, time.monotonic())
        reading = meter.read(look_at(counts, info, focus=how.focus), time.monotonic(), read)
        sink(counts, info, reading)
        if how.frames is not None and reading.frame >= how.frames:
            return
        ended.wait(max(0.0, 1.0 / how.fps - (time.monotonic() - started)))


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


def _serve(
    camera: "Camera",
    shot: Shot,
    how: Watching,
    lamps: "RigLamps",
    port: int,
    name: str,
    jogger: "Jogger | None",
    ended: threading.Event,
) -> None:
    """The picture on a page of the console, until the event is set."""
    with extra_packages("the page", "console"):
        from anisoscope.console.application import (
            HERE,
            Page,
            create_app,
            hosts_of,
            listen,
            run_server,
            server_of,
        )
    from anisoscope.console.access import Access
    from anisoscope.console.live import Eyes, Live
    from anisoscope.console.routes import live_router
    from anisoscope.console.trail import Trail
    from anisoscope.rig.hold import SharedCamera

    with listen(HERE, port, "--web-port") as listener:
        hosts = hosts_of(HERE, int(listener.getsockname()[1]))
        eyes = Eyes(SharedCamera(camera), None, shot.channel, lambda: lamps)  # the light is on, or not
        live = Live(eyes, gap_s=1.0 / how.fps, measure=how.focus)
        app = create_app(
            Access(None, Trail(None)),
            [live_router(live, shot.exposure_s, shot.gain, jogger, name)],
            hosts,
            pages=[Page("/station", "Picture")],
            lang=chosen_language(),
            closing=live.pause,
        )
        print(  # noqa: T201
            message("live picture at {path}", path=f"http://{HERE}:{listener.getsockname()[1]}/"), flush=True
        )
        write_line(message("Ctrl-C ends it"))
        run_server(server_of(app), listener, ended)


@contextmanager
def _sink(jogger: "Jogger | None", *, json_: bool) -> "Iterator[Sink]":
    if json_:
        yield lambda _counts, _info, reading: print_json_line(reading)
    elif sys.stdout.isatty():
        from rich.live import Live

        with Live(auto_refresh=False, transient=False) as screen:
            yield _to_screen(screen, jogger)
    else:
        yield lambda _counts, _info, reading: print(plain(reading), flush=True)  # noqa: T201


def _to_screen(screen: Any, jogger: "Jogger | None") -> "Sink":  # noqa: ANN401 - rich's Live
    from rich.text import Text

    def show(_counts: "Counts", _info: "CameraInfo", reading: "Reading") -> None:
        moved = "" if jogger is None else f"\n{message('arrows move')}: {jogger.state()}"
        screen.update(Text(panel(reading) + moved), refresh=True)

    return show


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
        *(f"{name}: {words}" for name, words in _lamps(reading)),
    ]
    return per_cent("  ".join(words))


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
        *_lamps(reading),
        (message("frame"), f"{reading.frame}, {_speed(reading.frames_per_s)}; {ends}"),
    )
    width = max(len(name) for name, _ in rows)
    return per_cent("\n".join(f"{name:<{width}}  {text}" for name, text in rows))


def blocks(histogram: tuple[float, ...]) -> str:
    """A histogram as a row of blocks, by the square root of the share so that small shares show."""
    top = max(histogram)
    if top <= 0.0:
        return BLOCKS[0] * len(histogram)
    return "".join(BLOCKS[math.ceil((len(BLOCKS) - 1) * math.sqrt(share / top))] for share in histogram)


def _lamps(reading: "Reading") -> list[tuple[str, str]]:
    """Names of the lamps of the rig, and what they say."""
    from anisoscope.live_view.lamps import in_words

    return [(translated(one.name), in_words(one)) for one in reading.lamps]


def _focus(share: float) -> str:
    return message("too dark") if math.isnan(share) else f"{share:.0%}"


def _speed(frames_per_s: float) -> str:
    return "" if math.isnan(frames_per_s) else message("{rate} frames/s", rate=f"{frames_per_s:.1f}")

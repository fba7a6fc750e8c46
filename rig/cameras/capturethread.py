"""``cv2.VideoCapture`` behind a thread of its own, so that a call that never returns stops nothing else.

OpenCV blocks in the driver when a camera is pulled out in mid-frame, for ten seconds or for ever. All calls go
through one thread (some drivers want it so); the caller waits for a stated time. A thread that did not answer
is given up, and with it the camera: whatever is asked afterwards fails at once.
"""

import contextlib
import queue
import threading
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from anisoscope.base.errors import CameraError, NotConnected

T = TypeVar("T")
_TRIES = 2
Picture = npt.NDArray[Any]


class Capture(Protocol):
    """Used part of ``cv2.VideoCapture``."""

    def isOpened(self) -> bool: ...  # noqa: D102, N802 - OpenCV's names
    def set(self, prop: int, value: float, /) -> bool: ...  # noqa: D102
    def get(self, prop: int, /) -> float: ...  # noqa: D102
    def grab(self) -> bool: ...  # noqa: D102
    def read(self) -> tuple[bool, Any]: ...  # noqa: D102
    def release(self) -> None: ...  # noqa: D102


class CaptureThread:
    """Capture that is opened, used and released in one thread."""

    def __init__(self, open_capture: Callable[[], Capture], name: str, timeout_s: float) -> None:
        """Open a capture.

        Args:
            open_capture: opens it; called in the thread.
            name: what the camera is called in messages.
            timeout_s: seconds that any call may take.

        Raises:
            NotConnected: there is no such camera, or opening it takes longer.
        """
        self.name = name
        self._timeout_s = timeout_s
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._gone = ""
        self._capture: Capture | None = None
        threading.Thread(target=self._work, name=f"camera {name}", daemon=True).start()
        try:
            self._call(lambda: self._open(open_capture), 0.0, "open")
        except BaseException:
            self._end()
            raise

    def set(self, prop: int, value: float) -> bool:
        """Set a property; returns whether the backend confirms it."""
        return self._call(lambda: bool(self._used().set(prop, value)), 0.0, "take a setting")

    def get(self, prop: int) -> float:
        """Read a property back."""
        return self._call(lambda: float(self._used().get(prop)), 0.0, "tell a setting")

    def discard(self, frames: int, exposure_s: float = 0.0) -> None:
        """Let frames pass.

        Raises:
            NotConnected: the camera delivers none, or not in time.
        """
        for _ in range(frames):
            self._until(lambda: (bool(self._used().grab()), True), exposure_s)

    def read(self, exposure_s: float = 0.0) -> Picture:
        """The next frame as OpenCV gives it; waits `exposure_s` seconds longer than for other calls.

        Raises:
            NotConnected: the camera delivers none, or not in time.
        """
        return np.asarray(self._until(lambda: self._used().read(), exposure_s))

    def close(self) -> None:
        """Release the capture; does not wait for a camera that hangs."""
        if not self._gone:
            with contextlib.suppress(CameraError, NotConnected):
                self._call(self._release, 0.0, "close")
            self._gone = "is closed: open it again"
        self._end()

    def _end(self) -> None:
        self._jobs.put(self._release)
        self._jobs.put(None)

    def _open(self, open_capture: Callable[[], Capture]) -> None:
        self._capture = open_capture()
        if not self._capture.isOpened():
            raise NotConnected(f"there is no {self.name}, or another program uses it")

    def _release(self) -> None:
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.release()

    def _used(self) -> Capture:
        assert self._capture is not None
        return self._capture

    def _until(self, job: Callable[[], tuple[bool, Any]], exposure_s: float) -> Any:  # noqa: ANN401 - a picture
        """A frame, with one retry if it is damaged."""
        for _ in range(_TRIES):
            good, picture = self._call(job, exposure_s, "deliver a frame")
            if good and picture is not None:
                return picture
        self._gone = "delivers no frames: was it unplugged?"
        raise NotConnected(f"{self.name} {self._gone}")

    def _call(self, job: Callable[[], T], more_s: float, what: str) -> T:
        if self._gone:
            raise NotConnected(f"{self.name} {self._gone}")
        answer: queue.SimpleQueue[tuple[T | None, Exception | None]] = queue.SimpleQueue()

        def run() -> None:
            try:
                answer.put((job(), None))
            except Exception as problem:  # noqa: BLE001 - carried over to the caller
                answer.put((None, problem))

        self._jobs.put(run)
        wait_s = self._timeout_s + more_s
        try:
            value, problem = answer.get(timeout=wait_s)
        except queue.Empty:
            self._gone = f"did not {what} in {wait_s:g} s: was it unplugged?"
            raise NotConnected(f"{self.name} {self._gone}") from None
        if isinstance(problem, NotConnected):
            raise problem
        if problem is not None:
            reason = " ".join(str(problem).split())
            raise CameraError(f"{self.name} could not {what}: {reason}") from problem
        return value  # type: ignore[return-value]  # None only where job returns None

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            with contextlib.suppress(Exception):  # releasing a camera that has gone
                job()

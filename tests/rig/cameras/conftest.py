"""A UVC camera made of software: it does to the driver what real ones do."""

import threading
from collections import deque

import cv2
import numpy as np
import pytest

MANUAL, AUTOMATIC = 1.0, 3.0
FOURCC = cv2.VideoWriter.fourcc


class FakeUvc:
    """Stands for ``cv2.VideoCapture`` of a V4L2 camera.

    Frames are exposed by the camera at its own pace into a queue; what is read is the oldest one, which may be
    from before the last change. The frame in the making at a change is half exposed with the old settings.
    """

    def __init__(self, scene, **habits):
        self.scene = scene  # relative light at 1 s of exposure, (rows, cols)
        self.exponent = 1.0
        self.black, self.white = 0, 255
        self.steps = range(1, 5001)  # exposures that it has, in 100 µs
        self.refuses = set()
        self.lies = {}  # properties that read back as something else
        self.formats = ("YUYV", "MJPG")
        self.sizes = ((48, 64), (24, 32))
        self.queue_length = 4
        self.keeps_queue = False
        self.fights_back = False
        self.noise = 0.3
        self.unplugged = False
        self.hangs = threading.Event()
        self.hangs.set()
        self.fails = 0
        vars(self).update(habits)
        self.values = {
            cv2.CAP_PROP_AUTO_EXPOSURE: AUTOMATIC,
            cv2.CAP_PROP_AUTO_WB: 1.0,
            cv2.CAP_PROP_EXPOSURE: 156.0,
            cv2.CAP_PROP_GAIN: 32.0,
            cv2.CAP_PROP_FOURCC: float(FOURCC(*"MJPG")),
            cv2.CAP_PROP_FRAME_WIDTH: 64.0,
            cv2.CAP_PROP_FRAME_HEIGHT: 48.0,
            cv2.CAP_PROP_CONVERT_RGB: 1.0,
            cv2.CAP_PROP_BUFFERSIZE: float(self.queue_length),
            cv2.CAP_PROP_MODE: 0.0,
        }
        self.asked = {}
        self.inner_gain = 1.0
        self.rng = np.random.default_rng(0)
        self.released = 0
        self.frames_read = 0
        self._fill()

    # -- what OpenCV calls -------------------------------------------------------------------------------------

    def isOpened(self):  # noqa: N802
        return True

    def get(self, prop):
        value = self.values.get(prop, -1.0)
        return self.lies.get(prop, value)

    def set(self, prop, value):
        if prop in self.refuses or prop not in self.values:
            return False
        if prop == cv2.CAP_PROP_EXPOSURE:
            if self.values[cv2.CAP_PROP_AUTO_EXPOSURE] != MANUAL:
                return False
            value = float(min(self.steps, key=lambda step: abs(step - value)))
        if prop == cv2.CAP_PROP_FOURCC and not self._has_format(value):
            return False
        if prop in {cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT}:
            return self._resize(prop, value)
        if prop == cv2.CAP_PROP_BUFFERSIZE:
            if self.keeps_queue:
                return False
            self.queue_length = int(value)
        self.values[prop] = value
        if prop in {cv2.CAP_PROP_FOURCC, cv2.CAP_PROP_BUFFERSIZE}:
            self._fill()  # the stream starts again
        elif prop == cv2.CAP_PROP_EXPOSURE:
            self.half_old = True
        return True

    def grab(self):
        return self.read()[0]

    def read(self):
        self.hangs.wait()
        if self.unplugged:
            return False, None
        if self.fails:
            self.fails -= 1
            return False, None
        oldest = self.queue.popleft()
        self.queue.append(self._expose())
        self.frames_read += 1
        return True, self._format(oldest)

    def release(self):
        self.released += 1

    # -- what the camera does ----------------------------------------------------------------------------------

    def turn_to(self, scene):
        """Another pose; frames in the queue show the one before, the next one both."""
        self.previous, self.scene = self.scene, scene
        self.half_old = True

    def _fill(self):
        self.half_old, self.previous = False, self.scene
        self.exposed_with = self.values[cv2.CAP_PROP_EXPOSURE]
        self.queue = deque(self._expose() for _ in range(self.queue_length))

    def _expose(self):
        raw = self.values[cv2.CAP_PROP_EXPOSURE]
        if self.values[cv2.CAP_PROP_AUTO_EXPOSURE] != MANUAL:
            raw = self.values[cv2.CAP_PROP_EXPOSURE] = 120.0
        light = self.scene * raw * 1e-4
        if self.half_old:
            light = 0.5 * (light + self.previous * self.exposed_with * 1e-4)
            self.half_old = False
        self.previous, self.exposed_with = self.scene, raw
        if self.fights_back:
            self.inner_gain *= (0.4 / max(light.mean() * self.inner_gain, 1e-6)) ** 0.5
            light = light * self.inner_gain
        counts = self.black + (self.white - self.black) * np.clip(light, 0.0, 1.0) ** self.exponent
        noisy = counts + self.rng.normal(0.0, self.noise, counts.shape)
        return np.clip(np.rint(noisy), 0, self.white).astype(np.uint8)

    def _format(self, grey):
        rows, cols = (
            round(self.values[cv2.CAP_PROP_FRAME_HEIGHT]),
            round(self.values[cv2.CAP_PROP_FRAME_WIDTH]),
        )
        grey = grey[:rows, :cols]
        if self.values[cv2.CAP_PROP_CONVERT_RGB]:
            return np.repeat(grey[..., None], 3, axis=2)
        if self.values[cv2.CAP_PROP_FOURCC] == FOURCC(*"GREY"):
            return grey
        return np.stack([grey, np.full_like(grey, 128)], axis=2)

    def _has_format(self, value):
        return int(value) in {FOURCC(*name) for name in self.formats}

    def _resize(self, prop, value):
        self.asked[prop] = value
        rows, cols = self.asked.get(cv2.CAP_PROP_FRAME_HEIGHT), self.asked.get(cv2.CAP_PROP_FRAME_WIDTH)
        if rows and cols:
            rows, cols = min(self.sizes, key=lambda size: abs(size[0] - rows) + abs(size[1] - cols))
            self.values[cv2.CAP_PROP_FRAME_HEIGHT], self.values[cv2.CAP_PROP_FRAME_WIDTH] = rows, cols
            self.asked = {}
            self._fill()
        return True


@pytest.fixture
def fake_uvc():
    return FakeUvc

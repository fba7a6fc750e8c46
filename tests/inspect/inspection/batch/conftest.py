"""Trays on the virtual rig."""

import pytest

from anisoscope.inspection.batch.operator import Answer, Unattended
from anisoscope.inspection.batch.run import run_batch
from anisoscope.inspection.batch.start import Order
from anisoscope.inspection.batch.tray import read_tray

TILE = {"sample": {"kind": "white-tile"}}
TWO_POSES = {"poses": {"angles_deg": [0.0, 90.0]}}


class Scripted(Unattended):
    """An operator whose answers are known beforehand, and who notes what was asked."""

    def __init__(self, answers=(), serials=(), troubles=(), asks=True):
        self._answers, self._serials, self._troubles = list(answers), list(serials), list(troubles)
        self._asks = asks
        self.asked = []
        self.done = []

    @property
    def asks(self):
        return self._asks

    def place(self, slot, *, again, needs_serial):
        self.asked.append((slot.slot, again))
        answer = self._answers.pop(0) if self._answers else Answer()
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def place_all(self, parts):
        self.asked.append(f"{parts} at once")
        return True

    def serial_of(self, slot, why):
        self.asked.append((slot.slot, why))
        return self._serials.pop(0) if self._serials else None

    def trouble(self, slot, faults):
        self.asked.append((slot.slot, faults))
        return self._troubles.pop(0)

    def finished(self, batch, number):
        self.done.append(batch.slots[number].word)


@pytest.fixture
def scripted():
    return Scripted


@pytest.fixture
def tray_of(virtual_rig, tmp_path):
    """``tray_of("slot,serial\\n1,A17\\n", bench={...})`` gives the order of a tray on one virtual rig.

    Without changes a tile lies there: it has no markers and is INVALID, which is found out quickly.
    """

    def lay_out(text, look=None, **changes):
        rig = virtual_rig("rig", **(changes or {"bench": TILE, "recipe": TWO_POSES}))
        path = tmp_path / "tray.csv"
        path.write_text(text, encoding="utf-8")
        return Order(read_tray(path), rig.recipe, rig.rig, tmp_path / "batch", "M. M.", "line 2", look)

    return lay_out


@pytest.fixture
def remembered():
    """What was entered into the history: serial numbers, in order."""
    return []


@pytest.fixture
def run(remembered, undiagnosed):
    """Runs a batch."""

    def start(order, operator=None, **options):
        options = {"methods": undiagnosed, **options}
        return run_batch(
            order, operator or Unattended(), lambda found: remembered.append(found.record.serial), **options
        )

    return start

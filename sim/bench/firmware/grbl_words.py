"""The words of G-code as Grbl 1.1 takes a block apart: letters, values, modal groups, and what it refuses.

Source: the description of Grbl 1.1 and NIST RS274/NGC.
"""

import re
from dataclasses import dataclass

from anisoscope.sim.bench.firmware.grbl_settings import AXES

LETTER, NUMBER, STATEMENT, NEGATIVE, INVALID_JOG = 1, 2, 3, 4, 16
UNSUPPORTED, GROUP_TWICE, NO_FEED, NOT_WHOLE, AXIS_CONFLICT, REPEATED, NO_AXIS = 20, 21, 22, 23, 24, 25, 26
LINE_NUMBER, VALUE_MISSING, BAD_SYSTEM, AXIS_UNDER_G80, UNUSED, TOO_LARGE = 27, 28, 29, 31, 36, 38
_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
_GROUPS = {
    "motion": ("G0", "G1", "G80"),
    "plane": ("G17", "G18", "G19"),
    "units": ("G20", "G21"),
    "cutter": ("G40",),
    "length": ("G49",),
    "system": tuple(f"G{number}" for number in range(54, 60)),
    "control": ("G61",),
    "distance": ("G90", "G91"),
    "arcs": ("G91.1",),
    "feed_mode": ("G93", "G94"),
    "once": ("G4", "G10", "G28", "G28.1", "G30", "G30.1", "G53", "G92", "G92.1"),
    "flow": ("M0", "M1", "M2", "M30"),
    "spindle": ("M3", "M4", "M5"),
    "coolant": ("M8", "M9"),
}
_GROUP_OF = {word: group for group, words in _GROUPS.items() for word in words}
WITH_AXES = frozenset({"G10", "G28", "G30", "G92"})


class GcodeError(Exception):
    """A block that is refused; `code` is the number of the error."""

    def __init__(self, code: int) -> None:
        super().__init__(f"error:{code}")
        self.code = code


@dataclass
class Words:
    """The words of one block: commands by group, values by letter."""

    commands: dict[str, str]
    values: dict[str, float]

    @property
    def once(self) -> str:
        """The command that holds for this block only, or ""."""
        return self.commands.get("once", "")

    @property
    def axes(self) -> dict[int, float]:
        """Values of the axes that are named."""
        return {AXES.index(letter): value for letter, value in self.values.items() if letter in AXES}


def read_words(text: str) -> Words:
    """Take a block apart.

    Raises:
        GcodeError: with the number that Grbl answers.
    """
    words = Words({}, {})
    at = 0
    while at < len(text):
        match = _WORD.match(text, at)
        if match is None:
            raise GcodeError(NUMBER if text[at].isalpha() else LETTER)
        at = match.end()
        letter, value = match[1], float(match[2])
        if letter in "GM":
            _add_command(words, letter, value)
        elif letter not in "FIJKLNPRSTXYZ":
            raise GcodeError(UNSUPPORTED)
        elif letter in words.values:
            raise GcodeError(REPEATED)
        elif letter in "FNPTS" and value < 0.0:
            raise GcodeError(NEGATIVE)
        else:
            words.values[letter] = value
    return words


def _add_command(words: Words, letter: str, value: float) -> None:
    word = f"{letter}{value:g}"
    if word not in _GROUP_OF:
        whole = f"{letter}{int(value)}"
        raise GcodeError(NOT_WHOLE if whole in _GROUP_OF and value % 1.0 and whole != "G90" else UNSUPPORTED)
    group = _GROUP_OF[word]
    both = {word, *words.commands.values()}
    if both & WITH_AXES and both & {"G0", "G1"}:
        raise GcodeError(AXIS_CONFLICT)
    if group in words.commands:
        raise GcodeError(GROUP_TWICE)
    words.commands[group] = word

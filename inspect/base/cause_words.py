"""A cause in plain words, for people who are no optics engineers: what was found, and what to do next."""

from dataclasses import dataclass

SEAT_AGAIN = "Seat it again once, pressed home on a clean seat; if it fails again, reject"


@dataclass(frozen=True)
class CauseWords:
    """A cause in plain words.

    Attributes:
        more: the finding at a positive extent; ``{size}`` stands for the extent with its unit, ``{name}`` for what
            follows in the cause's name, where several causes share these words.
        action: what to do next.
        less: the finding at a negative extent; "" if that is the same sentence.
        opposite: cause of the opposite sign that is a cause of its own, or "".
        either: the finding where this cause and its opposite tie.
        percent: an extent without unit is a share, shown in per cent.
        region: name of a region of the deviation map where this is the cause; "" if the shape of the region says it.
    """

    more: str
    action: str
    less: str = ""
    opposite: str = ""
    either: str = ""
    percent: bool = True
    region: str = ""

    def finding(self, extent: float) -> str:
        """The sentence at an extent, its size left open."""
        return self.less if extent < 0.0 and self.less else self.more

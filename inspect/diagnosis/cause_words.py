"""Sentences of causes for people who are no optics engineers: what was found, with its size, and what to do next."""

from collections.abc import Mapping
from dataclasses import dataclass


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


def words_of(cause: str, words: Mapping[str, CauseWords]) -> tuple[str, CauseWords] | None:
    """Name and words of a cause: its own, or those of the causes that begin alike (``wrong-ink`` of all wrong inks)."""
    if cause in words:
        return cause, words[cause]
    alike = [name for name in words if cause.startswith(f"{name}-")]
    return (alike[0], words[alike[0]]) if alike and "+" not in cause else None


SEAT_AGAIN = "Seat it again once, pressed home on a clean seat; if it fails again, reject"
_TOOL = "and have the tool checked"

RIG_WORDS: Mapping[str, CauseWords] = {
    "seating-x": CauseWords(
        "The part was tilted about x by about {size}",
        "Clean the seat, press the part home and inspect it again",
    ),
    "seating-y": CauseWords(
        "The part was tilted about y by about {size}",
        "Clean the seat, press the part home and inspect it again",
    ),
    "light-angle": CauseWords(
        "The lamp stands about {size} too far from the camera",
        "Do not reject: check the lamp, run the commissioning again, then inspect the part again",
        "The lamp stands about {size} too close to the camera",
    ),
}
"""Causes that are not the part, alike for all surfaces."""

PLASTIC_WORDS: Mapping[str, CauseWords] = {
    "burrs": CauseWords(
        "Burrs cover about {size} of the area",
        f"Reject or deburr the part {_TOOL} for chipped edges and cracks",
        region="burr",
    ),
    "wear": CauseWords(
        "Ridge edges are worn to a radius of about {size}", f"Reject the part {_TOOL} for wear"
    ),
    "incomplete-filling": CauseWords(
        "Ridges are not filled: about {size} of their height is missing",
        "Reject the part; raise melt or mould temperature or packing pressure, and clean the vents",
    ),
    "ridge-angle": CauseWords(
        "Ridges are about {size} steeper than designed",
        f"{SEAT_AGAIN}: the angle of the ridges comes from the mould",
        "Ridges are about {size} flatter than designed",
    ),
    "pitch": CauseWords(
        "The pitch is about {size} too large",
        "Reject the part and check shrinkage and feed of the tool's machining",
        "The pitch is about {size} too small",
    ),
    "rough-facets": CauseWords(
        "Facets are rough: their roughness across the ridges is higher by about {size}",
        f"Reject the part {_TOOL}: polish, corrosion, built-up edge",
        percent=False,
    ),
    "scratches": CauseWords(
        "The part is scratched: about {size}",
        "Reject the part; check grippers, packing and ejection",
        region="scratch",
    ),
    "dust": CauseWords(
        "Dust lies on the part: about {size}",
        "Blow the part clean and inspect it again; if it fails again, reject",
        region="dust",
    ),
    "missing-ridges": CauseWords(
        "About {size} of the ridges are missing",
        f"Reject the part {_TOOL} for clogged grooves",
        region="missing ridge",
    ),
    "chatter": CauseWords(
        "The facets bear chatter marks of about {size} amplitude",
        f"Reject the part {_TOOL}: the marks come from its machining",
    ),
    "roughness-along": CauseWords(
        "Facets are about {size} rougher along the ridges than the recipe states",
        f"Reject the part {_TOOL}: its polish has changed",
        "Facets are about {size} smoother along the ridges than the recipe states",
    ),
    "roughness-across": CauseWords(
        "Facets are about {size} rougher across the ridges than the recipe states",
        f"Reject the part {_TOOL}: its polish has changed",
        "Facets are about {size} smoother across the ridges than the recipe states",
    ),
    "roughness": CauseWords(
        "The surface is about {size} rougher than the recipe states",
        f"Reject the part; check the mould temperature {_TOOL}",
        "The surface is about {size} smoother than the recipe states",
    ),
    "colour": CauseWords(
        "The plastic is about {size} brighter than the recipe states",
        "Clean the part and inspect it again; if it fails again, reject, and check the batch of the material",
        "The plastic is about {size} darker than the recipe states",
    ),
    "plastic-or-lamp": CauseWords(
        "The plastic or the lamp is not that of the recipe",
        "Do not reject yet: check the lamp's angle, and calibrate the material (anisoscope calibrate material)",
    ),
    **RIG_WORDS,
}
"""Causes of plastic parts with ridges."""

"""Sentences of causes: what was found, with its size, and what to do next."""

from collections.abc import Mapping

from anisoscope.base.cause_words import CauseWords
from anisoscope.diagnosis.rig_causes import LIGHT_ADDED, POSE_SCALED, SEATS
from anisoscope.profiles.defect_injection import DEFECTS


def words_of(cause: str, words: Mapping[str, CauseWords]) -> tuple[str, CauseWords] | None:
    """Name and words of a cause: its own, or those of the causes that begin alike (``wrong-ink`` of all wrong inks)."""
    if cause in words:
        return cause, words[cause]
    alike = [name for name in words if cause.startswith(f"{name}-")]
    return (alike[0], words[alike[0]]) if alike and "+" not in cause else None


_TOOL = "and have the tool checked"
_SEAT = "Do not reject: check how the part lies in its seat, seat it as the recipe says, and inspect it again"

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
    **{name: CauseWords(title[0].upper() + title[1:], _SEAT) for name, (title, _) in SEATS.items()},
    POSE_SCALED: CauseWords(
        "One pose is about {size} too bright, as by another lamp, exposure or gain",
        "Do not reject: check lamp, exposure and gain of the camera, then inspect the part again",
        "One pose is about {size} too dark, as by another lamp, exposure or gain",
    ),
    LIGHT_ADDED: CauseWords(
        "Light is added to all poses, about {size} of the darkest one",
        "Do not reject: keep other light off the rig, check the dark frames, then inspect the part again",
        "Light is missing in all poses, about {size} of the darkest one",
    ),
}
"""Causes that are not the part, alike for all surfaces."""

FINISH_WORDS: Mapping[str, CauseWords] = {
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
}
"""Causes of the plastic and its finish."""


def plastic_words() -> Mapping[str, CauseWords]:
    """Causes of plastic parts with ridges."""
    return {**{name: one.words for name, one in DEFECTS.items()}, **FINISH_WORDS, **RIG_WORDS}

"""What may be wrong with the ink of a print: causes with the extents that are looked at, and the state each makes.

Each is a change of the ink model's state (`anisoscope.prints.model.State`); what is wrong with the sheet (curl, spots)
is not among them.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from anisoscope.diagnosis.causes import Cause, Group
from anisoscope.prediction.sensitivity import State as RidgeState
from anisoscope.prints.bare import MISSING_INK, MISSING_TITLE
from anisoscope.prints.model import State
from anisoscope.profiles.heightmap import HeightMap

FloatArray = npt.NDArray[np.float64]
Extents = tuple[float, ...]

_DOUBT = 0.02
_SIZES = (0.02, 0.05, 0.1, 0.15, 0.25, 0.4, 0.6, 0.8, 1.0)
SHARES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7)
UP_TO_ALL = (*SHARES, 0.8, 0.9, 0.95, 0.98, 1.0)
_EXCESS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0)
LEANS_DEG = (0.2, 0.5, 1.0, 1.5, 2.0, 3.0)
_FAR_DEG = (*LEANS_DEG, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 15.0)
_SHIFTS_NM = (2.0, 4.0, 6.0, 10.0, 15.0, 20.0, 30.0)
_LEVEL_DOUBT = 0.005
"""Level and coverage act alike in all poses, whatever the ink; both are doubted alike, so that they tie."""
_SHIFT_DOUBT = 0.1
"""The spectra are known at steps of 10 nm, linear between them."""
_OF_INK = "ink: binder mixed in, other flakes or another batch; press: flakes do not lie flat"
Made = tuple[Cause, Extents, Callable[[float], State]]
"""A cause with its extents, and what state of the print it makes of an extent."""


def too_bright(coverage: float) -> list[Made]:
    """Causes of a level that is too high: brighter ink, and where the recipe's print is no solid one, more of it."""
    title = "level too high (ink brighter or denser, or lamp and flat not as they were), relative excess"
    brighter = cause_of("bright-ink", title, "", "finish", _BRIGHT, _LEVEL_DOUBT)
    found: list[Made] = [(brighter, _EXCESS, lambda e: State(red=_ln(e), green=_ln(e), blue=_ln(e)))]
    if coverage < 1.0:
        most = 1.0 / coverage - 1.0
        extents = (*(e for e in _EXCESS if e < 0.99 * most), most)
        gain = cause_of(
            "dot-gain",
            "dots too large: more ink than there should be, relative",
            "",
            "finish",
            _DOTS,
            _LEVEL_DOUBT,
        )
        found.append((gain, extents, lambda e: State(missing=-e)))
    return found


def _ln(excess: float) -> float:
    return float(np.log1p(excess))


_BRIGHT = (
    "ink: flakes that reflect more, or lie closer (another batch, a thicker layer); rig: lamp brighter than when the "
    "flat was taken, or a white tile that was dirty then"
)
_DOTS = "press: dots grow (pressure, thin ink, screen), or the wrong screen"


def of_ink(state: State) -> list[Made]:
    """Causes with their extents, and what state of the print each makes of an extent."""
    brush = np.array([state.ratio, state.skew])
    brush = brush / max(float(np.linalg.norm(brush)), 1e-12) if np.any(brush) else np.array([1.0, 0.0])
    brush = -brush if brush[0] < 0.0 else brush
    along = _brush_deg(brush)
    across = (along + 90.0) % 180.0
    lean = np.array([state.tilt_x_deg, state.tilt_y_deg])
    lean = lean / max(float(np.linalg.norm(lean)), 1e-12) if np.any(lean) else np.array([1.0, 0.0])
    toward = round(float(np.degrees(np.arctan2(lean[1], lean[0])))) % 360
    both = tuple(sorted({0.0, *(0.8 * s for s in _SIZES), *(-0.4 * s for s in _SIZES)}))
    return [
        (
            cause_of("roughness", "roughness of the lobe, relative change", "", "finish", _OF_INK),
            both,
            lambda e: State(alpha=float(np.log1p(e))),
        ),
        (
            cause_of(MISSING_INK, MISSING_TITLE, "", "finish", "press: too little ink, worn screen"),
            UP_TO_ALL,
            lambda e: State(missing=e),
        ),
        (
            cause_of(
                "brushing",
                f"brushed print: roughness at {across:.0f}° over {along:.0f}°, relative excess",
                "",
                "finish",
                "press: squeegee or roller combs the flakes",
            ),
            both,
            lambda e: State(ratio=float(brush[0] * np.log1p(e)), skew=float(brush[1] * np.log1p(e))),
        ),
        (
            cause_of(
                "lean",
                f"flakes shingled, or sheet not flat in its seat: leans toward {toward}° by",
                "°",
                "finish",
                "press: flakes lie on each other like shingles; handling: sheet does not lie flat",
            ),
            (0.0, *_FAR_DEG),
            lambda e: State(tilt_x_deg=float(lean[0] * e), tilt_y_deg=float(lean[1] * e)),
        ),
        (
            cause_of(
                "film-thickness",
                "film of the flakes: spectra shifted by",
                "nm",
                "finish",
                "ink: flakes with a thicker or thinner coat",
                _SHIFT_DOUBT,
            ),
            tuple(sorted({0.0, *_SHIFTS_NM, *(-s for s in _SHIFTS_NM)})),
            lambda e: State(shift_nm=e),
        ),
        (
            cause_of(
                "lobe-form",
                "form of the lobe, 0 as in the recipe, 1 the other distribution",
                "",
                "finish",
                "ink: flakes lie otherwise than those from which the ink file was made; set print.lobe by a good print",
            ),
            (-0.5, -0.25, -0.1, 0.0, 0.1, 0.25, 0.5, 0.75, 1.0, 1.5),
            lambda e: State(lobe=e),
        ),
    ]


def _brush_deg(brush: FloatArray) -> float:
    """Direction of the smaller roughness, 0 to 180 degrees, of a unit vector (ratio, skew)."""
    return round(float(0.5 * np.degrees(np.arctan2(brush[1], brush[0])))) % 180.0


def cause_of(name: str, title: str, unit: str, group: Group, explains: str, doubt: float = _DOUBT) -> Cause:
    """A cause of a print, whose signature comes from the ink or the sheet instead of a surface."""
    return Cause(name, title, unit, group, explains, (), _no_surface, doubt)


def _no_surface(surface: HeightMap, state: RidgeState, _extent: float) -> tuple[HeightMap, RidgeState]:
    """A print has no height map that a cause could change: its signature comes from the ink."""
    return surface, state

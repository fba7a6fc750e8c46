"""Causes of a deviating print: the change of all channels by each, and the ones that explain the measurement.

The signatures come from the ink model for the recipe's poses; causes are weighed and ranked as those of ridged parts
(`anisoscope.diagnosis.ranking`). Beside ln of the channels two numbers of the map are data: how the tilt
changes across the region, and the share of the area that deviates from the rest.

The causes are those of the ink, each with the extents that are looked at. Each is a change of the ink model's state
(`anisoscope.kinds.prints.model.State`); what is wrong with the sheet (curl, spots) is not among them.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cause_words import CauseWords
from anisoscope.base.errors import ModelError
from anisoscope.diagnosis.causes import Cause, Group
from anisoscope.diagnosis.evidence import Evidence
from anisoscope.diagnosis.likelihood import fit_extent, interval
from anisoscope.diagnosis.ranking import Diagnosis, diagnose
from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.kinds.prints.decision import PrintDecision
from anisoscope.kinds.prints.excluded_defects import deviation_of, direction
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.kinds.prints.lobe_fit import PrintFit
from anisoscope.kinds.prints.measurement import MeasuredPrint, cell_grid
from anisoscope.kinds.prints.missing_ink import MISSING_INK, MISSING_TITLE
from anisoscope.kinds.prints.model import Scene, State
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.sources import Source, total
from anisoscope.prediction.sensitivity import State as RidgeState
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.record.schema import CauseRecord

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
_OF_MISFIT, _MOST_DOUBT = 3.0, 0.6
"""Relative doubt of a change over what the ink file misses of the light: slopes of a lobe are known less than it is."""
"""The spectra are known at steps of 10 nm, linear between them."""
_OF_INK = "ink: binder mixed in, other flakes or another batch; press: flakes do not lie flat"
StateCause = tuple[Cause, Extents, Callable[[float], State]]
"""A cause with its extents, and what state of the print it makes of an extent."""


def too_bright(coverage: float) -> list[StateCause]:
    """Causes of a level that is too high: brighter ink, and where the recipe's print is no solid one, more of it."""
    title = "level too high (ink brighter or denser, or lamp and flat not as they were), relative excess"
    brighter = cause_of("bright-ink", title, "", "finish", _BRIGHT, _LEVEL_DOUBT)
    found: list[StateCause] = [(brighter, _EXCESS, lambda e: State(red=_ln(e), green=_ln(e), blue=_ln(e)))]
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


def of_ink(state: State) -> list[StateCause]:
    """Causes with their extents, and what state of the print each makes of an extent."""
    brush = direction(state.ratio, state.skew)
    brush = -brush if brush[0] < 0.0 else brush
    along = _brush_deg(brush)
    across = (along + 90.0) % 180.0
    lean = direction(state.tilt_x_deg, state.tilt_y_deg)
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


_BACKGROUND = 0.002
U_BACKGROUND = 0.004
"""Standard uncertainty of the share of the area that deviates on good prints."""


def explain_print(
    recipe: PrintRecipe, expected: PrintExpectation, measured: MeasuredPrint, decision: PrintDecision
) -> Diagnosis:
    """Rank the causes of a print.

    Args:
        recipe: its recipe.
        expected: the prediction.
        measured: the channels.
        decision: the verdict, with fit and map.
    """
    if decision.bare is not None:
        return decision.bare.diagnosis()
    logs, covariance, sources = deviation_of(
        expected, np.log(measured.channels).ravel(), decision.sources, decision.golden
    )
    found = None if decision.map is None else decision.map.record
    if found is None:
        known, evidence = known_causes(recipe, expected, decision.fit, 0), Evidence(logs, covariance)
        return _alone(diagnose(known, evidence, together=False), known, evidence, sources, doubt_of(expected))
    size = len(logs) + 1
    whole = np.zeros((size, size))
    whole[:-1, :-1], whole[-1, -1] = covariance, found.u_curl_deg**2
    curl = float(np.linalg.norm(found.curl_deg, 2))
    known = known_causes(recipe, expected, decision.fit, 1, np.array(found.curl_deg))
    evidence = Evidence(np.append(logs, curl), whole, found.share, found.u, _BACKGROUND, U_BACKGROUND)
    return _alone(diagnose(known, evidence, together=False), known, evidence, sources, doubt_of(expected))


def _alone(
    found: Diagnosis, known: Signatures, evidence: Evidence, sources: tuple[Source, ...], doubt: float
) -> Diagnosis:
    """The severities of the causes that count, each without the uncertainty of the input that it is itself."""
    by_name = {signature.cause.name: signature for signature in known.found}
    causes = []
    for one in found.causes:
        own = [source for source in sources if source.name in _OWN.get(one.cause, ())]
        if own and (one.tie or one.weight > _COUNTS):
            signature, rest = by_name[one.cause], evidence.covariance.copy()
            count = len(own[0].factor)
            rest[:count, :count] -= total(own, count)
            without = replace(evidence, covariance=rest)
            fit = fit_extent(signature, without)
            found_alone = {
                "severity": fit.extent,
                "u": fit.u if np.isfinite(fit.u) else None,
                "interval": interval(signature, without, fit),
            }
            one = one.model_copy(update=found_alone)  # noqa: PLW2901
        causes.append(one if one.cause in _OF_SHEET else _scaled(one, doubt))
    return replace(found, causes=tuple(causes))


_COUNTS = 0.01
_OF_SHEET = ("curl", "spots")
_OWN = {
    "roughness": ("roughness of the ink",),
    MISSING_INK: ("level of the ink",),
    "bright-ink": ("level of the ink",),
    "lean": ("seating tilt about x", "seating tilt about y"),
    "lobe-form": ("form of the lobe",),
    "film-thickness": ("colour of the ink",),
}
"""Inputs of the prediction that are the same thing as a cause."""


def doubt_of(expected: PrintExpectation) -> float:
    """Relative doubt of what causes change, of an ink whose file misses some of the light of its prints."""
    if not expected.misfit:
        return 0.0
    missed = np.sqrt(np.median(np.diag(total(expected.misfit, expected.channels.size))))
    return min(_OF_MISFIT * float(missed), _MOST_DOUBT)


def _scaled(one: CauseRecord, doubt: float) -> CauseRecord:
    """A cause whose change is known to a factor of 1 ± the doubt."""
    if doubt == 0.0 or one.interval is None or one.cause == "nothing":
        return one
    near, far = 1.0 / (1.0 + doubt), 1.0 / (1.0 - doubt)
    low, high = one.interval
    ends = (
        None if low is None else low * (far if low < 0.0 else near),
        None if high is None else high * (near if high < 0.0 else far),
    )
    u = None if one.u is None else float(np.hypot(one.u, doubt * one.severity))
    return one.model_copy(update={"u": u, "interval": ends})


def known_causes(
    recipe: PrintRecipe,
    expected: PrintExpectation,
    fit: PrintFit | None,
    extra: int,
    curl_deg: FloatArray | None = None,
) -> Signatures:
    """The signatures of all causes of a print.

    Args:
        recipe: its recipe.
        expected: the prediction.
        fit: gives the directions of brushing and lean; None for those along x.
        extra: 1 if the change of tilt across the region is a datum after ln of the channels, else 0.
        curl_deg: (2, 2) that change as the map shows it (`PrintMapRecord.curl_deg`), for its direction, or None.

    Raises:
        InkFileError: one of the wrong inks cannot be read.
    """
    state_causes = [*of_ink(State() if fit is None else fit.state), *too_bright(expected.scene.coverage)]
    signatures = [_of_state(expected.scene, *one, extra) for one in state_causes]
    signatures += [
        _of_state(
            replace(expected.scene, other=ink),
            cause_of(f"wrong-ink-{ink.name}", f"share of {ink.name} in the ink", "", "finish", _WRONG),
            UP_TO_ALL,
            lambda extent: State(other=extent),
            extra,
        )
        for ink in recipe.print.read_wrong_inks()
    ]
    signatures = [
        replace(one, cause=replace(one.cause, doubt=float(np.hypot(one.cause.doubt, doubt_of(expected)))))
        for one in signatures
    ]
    if extra:
        signatures += [_curl(recipe, expected, curl_deg), _spots(expected.scene)]
    return Signatures(expected.poses, expected.channels.ravel(), 0.0, tuple(signatures), ())


_WRONG = "press: ink of another job in the pan or the screen"


def _of_state(
    scene: Scene, cause: Cause, extents: Extents, state: Callable[[float], State], extra: int
) -> Signature:
    good, usable, changes = scene.log_channels(), [], []
    for extent in extents:
        try:
            channels = scene.channels(state(extent)).ravel()
        except ModelError:
            continue
        if channels.min() <= 0.0:  # all the ink gone from a black sheet
            continue
        changes.append(np.append(np.log(channels) - good, np.zeros(extra)))
        usable.append(extent)
    return Signature(cause, np.array(usable), np.array(changes), np.zeros(len(usable)))


def _curl(recipe: PrintRecipe, expected: PrintExpectation, curl_deg: FloatArray | None) -> Signature:
    """A sheet that bends: tilt grows evenly across the region, so that its ends deviate from the middle."""
    assert recipe.area is not None
    # close together: cells pass the limit one after the other
    extents = np.append(np.arange(0.0, LEANS_DEG[-1] + 0.05, 0.1), np.arange(3.25, 8.1, 0.25))
    way = np.diag([1.0, 0.0]) if curl_deg is None or not np.any(curl_deg) else curl_deg
    tilts = _places(recipe) @ (way / np.linalg.norm(way, 2)).T
    alike, of_cells = np.unique(np.round(tilts, 9), axis=0, return_inverse=True)
    eye, changes, shares = expected.eye, [], []
    for extent in extents:
        ways = expected.scene.leaning(extent * alike)
        region = ways[of_cells.ravel()]
        mean = region.mean(axis=0)
        changes.append(np.append(np.log(mean / expected.channels).ravel(), extent))
        off = eye.difference(ways, np.broadcast_to(np.median(region, axis=0), ways.shape)).max(axis=1)
        shares.append(float(np.mean(off[of_cells.ravel()] > recipe.area.cell_delta_e)))
    cause = cause_of("curl", "curled sheet, change of tilt across the region", "°", "shape", _CURLED, 0.05)
    return Signature(cause, extents, np.array(changes), np.array(shares))


def _places(recipe: PrintRecipe) -> FloatArray:
    """(N, 2) places of cells, by the size of the region, from its middle; of large maps not all."""
    rows, cols = (min(count, _MOST_PLACES) for count in cell_grid(recipe).shape)
    y, x = np.meshgrid(*((np.arange(count) + 0.5) / count - 0.5 for count in (rows, cols)), indexing="ij")
    return np.stack([x.ravel(), -y.ravel()], axis=-1)


_MOST_PLACES = 24
_CURLED = "handling: sheet dried unevenly, or is not held down at its edges"


def _spots(scene: Scene) -> Signature:
    """Ink missing in spots: those cells deviate, and the mean shows half of their share."""
    good = scene.log_channels()
    extents = np.array(SHARES)
    changes = [np.append(scene.log_channels(State(missing=0.5 * e)) - good, 0.0) for e in SHARES]
    cause = cause_of("spots", "spots, share of the area", "", "area", "press: dust, pinholes, clogged mesh")
    return Signature(cause, extents, np.array(changes), extents)


_STOP = "Stop the press and set the print aside"
PRINT_WORDS: Mapping[str, CauseWords] = {
    "roughness": CauseWords(
        "The flakes lie about {size} less flat than in a good print",
        f"{_STOP}; check binder, drying and the batch of the ink",
        "The flakes lie about {size} flatter than in a good print",
    ),
    MISSING_INK: CauseWords(
        "About {size} of the ink is missing", f"{_STOP}; check ink supply, pressure and the screen"
    ),
    "brushing": CauseWords(
        "The print is brushed: its roughness differs by about {size} between two directions",
        f"{_STOP}; check angle and pressure of squeegee or roller",
    ),
    "lean": CauseWords(
        "The flakes or the sheet lean by about {size}",
        "Lay the sheet flat and inspect it again; if it fails again, set the print aside",
    ),
    "film-thickness": CauseWords(
        "The colour is shifted by about {size} toward longer wavelengths",
        f"{_STOP} and check the batch of the flakes",
        "The colour is shifted by about {size} toward shorter wavelengths",
    ),
    "lobe-form": CauseWords(
        "The flakes lie in another way than those of the ink file",
        "Do not reject: set print.lobe of the recipe by a good print, then inspect again",
    ),
    "bright-ink": CauseWords(
        "The print is about {size} too bright",
        "Clean the white tile and take the flat again; then inspect again",
    ),
    "dot-gain": CauseWords(
        "The dots carry about {size} too much ink", f"{_STOP}; check pressure and ink viscosity"
    ),
    "wrong-ink": CauseWords(
        "About {size} of the ink is another one: {name}", f"{_STOP}; empty and clean ink pan and screen"
    ),
    "curl": CauseWords(
        "The sheet is curled: its tilt changes by about {size} across the region",
        "Hold the sheet down flat and inspect it again",
    ),
    "spots": CauseWords(
        "Spots cover about {size} of the area", f"{_STOP}; clean the screen of dust and clogged mesh"
    ),
}
"""Causes of prints in plain words."""

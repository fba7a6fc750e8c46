"""Page of a soft proof: one self-contained file with a WebGL 2 view."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.report.figures import png_uri
from anisoscope.report.page import packed, scripted, write_page
from anisoscope.sim.light.colour.illuminant import Illuminant
from anisoscope.sim.light.ink.distributions import tail_of
from anisoscope.sim.light.ink.ink import Ink
from anisoscope.sim.light.ink.model import MODELS, Model
from anisoscope.sim.light.ink.table import ENTRIES, ink_table

Float32 = npt.NDArray[np.float32]
State = dict[str, Any]

LABELS: dict[Model, str] = {
    "goniochromatic": "Goniochromatic (Eq. 5)",
    "schlick": "Standard (Schlick)",
    "tio2": "Standard (TiO₂ × ρ)",
}
SELFTEST_SIZE = 40


@dataclass(frozen=True, eq=False)
class ProofLight:
    """A light that the page offers.

    Attributes:
        illuminant: its spectrum.
        white: (3,) linear sRGB of its white.
        adapt: (3, 3) from its white to that of sRGB.
    """

    illuminant: Illuminant
    white: FloatArray
    adapt: FloatArray


@dataclass(frozen=True, eq=False)
class ProofMesh:
    """A mesh.

    Attributes:
        vertices: (V, 11) place, normal, tangent, place on the print.
        triangles: (T, 3).
    """

    vertices: Float32
    triangles: npt.NDArray[np.uint32]


@dataclass(frozen=True, eq=False)
class Proof:
    """Content of a page.

    Attributes:
        title: of the page.
        subtitle: below it.
        inks: one or more, up to fifteen: inks, and what they are on top of each other.
        lights: one or more.
        halftone_pngs: RGB pictures of the dots, three inks each, 255 where an ink covers all of a dot.
        tones_pngs: RGB pictures of coverages, 255 for 1.
        aspect: width of the print over its height.
        exposure: factor on linear light.
        fill: share of the view that a unit sphere takes.
        second_light_deg: azimuth and elevation of the second light.
        start: first state of the controls, by their names.
        roughness: presets: name, label, α or None for the ink's own.
        facts: pairs to list.
        notes: sentences to add.
        warnings: sentences to put first.
        mesh: for the shape "mesh".
        photo: a data URI.
        still: PNG of the first state, for browsers without WebGL.
        substrate: diffuse reflectance of the sheet.
    """

    title: str
    subtitle: str
    inks: tuple[Ink, ...]
    lights: tuple[ProofLight, ...]
    halftone_pngs: tuple[bytes, ...]
    tones_pngs: tuple[bytes, ...]
    aspect: float
    exposure: float
    fill: float
    second_light_deg: tuple[float, float]
    start: State
    roughness: tuple[tuple[str, str, float | None], ...]
    facts: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    mesh: ProofMesh | None = None
    photo: str | None = None
    still: bytes | None = None
    substrate: float = 0.0
    selftest: tuple[State, ...] = field(default=())


def write_proof_page(proof: Proof, path: Path) -> None:
    """Write the page, atomically.

    Raises:
        UsageError: more inks than pictures hold, or one whose distribution of normals the page does not know.
        RecordError: the file cannot be written.
    """
    if not 1 <= len(proof.inks) <= 3 * min(len(proof.halftone_pngs), len(proof.tones_pngs)):
        raise UsageError(f"a proof of {len(proof.inks)} inks needs a picture for every three of them")
    for ink in proof.inks:
        if tail_of(ink.distribution) != 1.0 or ink.base:
            raise UsageError(
                f"{ink.name}: the page draws the distribution 'ggx' without a base, not {ink.distribution!r}"
                f"{' with one' if ink.base else ''}: use --png"
            )
    models = [(key, LABELS[key]) for key in MODELS]
    shapes = [("sphere", "sphere"), ("cylinder", "cylinder"), ("plane", "plane")]
    pictures = [("halftone", "halftone"), ("tones", "continuous tones")]
    content = {
        "title": proof.title,
        "subtitle": proof.subtitle,
        "warnings": proof.warnings,
        "facts": proof.facts,
        "notes": proof.notes,
        "photo": proof.photo,
        "still": None if proof.still is None else png_uri(proof.still),
        "shapes": shapes if proof.mesh is None else [*shapes, ("mesh", "mesh")],
        "prints": pictures + [(f"solid{k}", f"solid {ink.name}") for k, ink in enumerate(proof.inks, 1)],
        "illuminants": [(k, one.illuminant.name) for k, one in enumerate(proof.lights)],
        "models": models,
        "roughness": [(key, label) for key, label, _ in proof.roughness],
        **scripted(_data(proof), "webgl.js", "proof.js"),
    }
    write_page(path, "proof.html", content)


def tables(inks: Sequence[Ink], lights: Sequence[ProofLight]) -> Float32:
    """(lights · models · inks, 256, 3) linear sRGB tables, in the order in which the page looks them up."""
    found = [ink_table(ink, one.illuminant, model).rgb for one in lights for model in MODELS for ink in inks]
    return np.array(found, dtype=np.float32).reshape(-1, ENTRIES, 3)


def _data(proof: Proof) -> dict[str, Any]:
    mesh = proof.mesh
    return {
        "inks": [
            {"name": ink.name, "alpha": ink.alpha, "alpha_y": ink.across, "brush_deg": ink.brush_deg}
            for ink in proof.inks
        ],
        "models": [{"key": key, "label": LABELS[key]} for key in MODELS],
        "illuminants": [
            {"name": one.illuminant.name, "white": one.white.tolist(), "adapt": one.adapt.ravel().tolist()}
            for one in proof.lights
        ],
        "tables": packed(tables(proof.inks, proof.lights)),
        "halftone": [png_uri(one) for one in proof.halftone_pngs],
        "tones": [png_uri(one) for one in proof.tones_pngs],
        "aspect": proof.aspect,
        "exposure": proof.exposure,
        "substrate": proof.substrate,
        "fill": proof.fill,
        "second": list(proof.second_light_deg),
        "start": proof.start,
        "roughness": [{"key": key, "alpha": alpha} for key, _, alpha in proof.roughness],
        "mesh": None
        if mesh is None
        else {"vertices": packed(mesh.vertices), "triangles": packed(mesh.triangles)},
        "selftest": list(
            proof.selftest or selftest_cases(mesh is not None, len(proof.lights), len(proof.inks))
        ),
        "selftest_size": SELFTEST_SIZE,
    }


def selftest_cases(mesh: bool, lights: int, inks: int = 3) -> list[State]:
    """Cases of ``#selftest``: all inks, models and prints under two lights, and every shape and extra."""
    plain = {
        "shape": "sphere",
        "yaw": 0,
        "pitch": 0,
        "second": True,
        "dots": "each",
        "roughness": "file",
        "match": False,
    }
    plain |= {"zoom": 1, "exposure": 0, "adapt": False, "azimuth": 135, "elevation": 45}
    found = [
        plain | {"illuminant": number, "model": model, "print": what}
        for number in range(min(lights, 2))
        for model in MODELS
        for what in ("halftone", "tones", *(f"solid{k}" for k in range(1, inks + 1)))
    ]
    turned = plain | {"illuminant": 0, "model": "goniochromatic", "print": "tones", "yaw": 35, "pitch": 25}
    match = {"match": True, "phong": 0.05, "shininess": 4, "scattering": 0.1, "behind": 0.1}
    found += [
        turned | {"shape": shape} for shape in ("sphere", "cylinder", "plane", *(["mesh"] if mesh else []))
    ]
    found.append(turned | {"shape": "plane", "yaw": 160, "pitch": -10} | match)
    found.append(turned | {"shape": "cylinder"} | match)
    found.append(turned | {"adapt": True, "illuminant": min(lights, 2) - 1, "exposure": 0.5})
    found.append(turned | {"roughness": "own", "alpha": 0.3, "model": "schlick", "print": "halftone"})
    return found

"""Plates made of ridges, which show pictures or codes: recipe, height maps, and files of their mould insert."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.json_fields import LEFT_OUT, in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.kinds.plates.code_grades import Grade
from anisoscope.kinds.plates.decision import predicted_code
from anisoscope.kinds.plates.expectation import expected_plate
from anisoscope.kinds.plates.recipe import PlateRecipe, Symbology
from anisoscope.kinds.registry import kind_named
from anisoscope.operations.demo.plates import Trial, check_trial, photograph
from anisoscope.parameters.keywords import by_keywords
from anisoscope.parameters.manufacture import CodeDesign, Manufacture, PlateDesign
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.comparison import turned_over
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.plates import Plan, plan_of_modules, plate_map
from anisoscope.report.plate_page import write_plate_page
from anisoscope.sim.design.plates import PictureDesign, check_mould, design_pictures, modules_of_code
from anisoscope.sim.design.solids import Body, write_body
from anisoscope.sim.design.toolpath import Tool, insert_path, write_gcode, write_passes

MOST_POINTS = 60_000_000
"""Points of a height map: half a gigabyte."""
MOST_ANGLES = 3
LIGHT_DEG = 10.0
READ_AT_DEG = 0.0, 90.0
SHOWN = 40  # characters of a long text in a message
PICTURE_RIDGES = RidgeDesign(50.0, 8.0, 10.0, edge_radius_um=1.0)
"""Usual ridges of pictures; the angle is chosen for every field."""
CODE_RIDGES = RidgeDesign(50.0, 10.0)
Tone = Literal["linear", "srgb"]


@dataclass(frozen=True)
class Likeness:
    """Likeness of pictures to their targets, one value a picture.

    Attributes:
        ssim: structural similarity, 1 where equal.
        cross_talk: share of the other picture that shows.
    """

    ssim: tuple[float, ...]
    cross_talk: tuple[float, ...]


@dataclass(frozen=True)
class DesignedPlate:
    """A plate that shows pictures.

    Attributes:
        found: directions and ridge angles of the fields, and what is predicted of them.
        light_angle_deg: between light and camera.
        likeness: of the predicted pictures.
        camera: of photographs on the virtual rig; None without a trial.
        cut_length_m: length of the cuts of the insert; None without a path.
        cut_minutes: time of its program, without acceleration.
        files: written files.
        trial: the inspection on the virtual rig.
    """

    found: PictureDesign = field(metadata=LEFT_OUT)
    light_angle_deg: float = field(metadata=LEFT_OUT)
    likeness: Likeness = field(metadata=json_field(merged=True))
    camera: Likeness | None
    cut_length_m: float | None
    cut_minutes: float | None
    files: tuple[Path, ...]
    trial: Trial | None

    @property
    @in_json()
    def fields(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.found.plan.shape

    @property
    @in_json()
    def size_mm(self) -> tuple[float, float]:
        """(wide, high)."""
        return self.found.plan.size_mm

    @property
    @in_json()
    def stages_deg(self) -> tuple[float, ...]:
        """Stage angles of the pictures."""
        return self.found.stages_deg

    @property
    @in_json()
    def black_per_sr(self) -> float:
        """Radiance of black."""
        return self.found.black

    @property
    @in_json()
    def white_per_sr(self) -> float:
        """Radiance of white."""
        return self.found.white

    @property
    @in_json()
    def classes(self) -> int:
        """Classes of fields."""
        return len(self.found.plan.letters)

    @property
    @in_json()
    def missed(self) -> float:
        """Largest error of a grey, share of white less black."""
        return self.found.missed


@by_keywords(plate=PlateDesign)
def design_plate(
    pictures: Sequence[FloatArray],
    out: Path,
    *,
    plate: PlateDesign,
    names: Sequence[str] = ("first", "second"),
    ridges: RidgeDesign = PICTURE_RIDGES,
    material: Material | None = None,
    make: Manufacture | None = None,
    on_progress: Advance = silent,
) -> DesignedPlate:
    """Make a plate of ridges that shows a grey picture, and another one when it is turned: ``anisoscope design plate``.

    Writes plan.csv, fields.csv, recipe.toml, height maps of part and insert, a predicted picture a stage angle and
    appearance.html into a folder, and what ``make`` asks for.

    Args:
        pictures: one or two pictures (rows, cols), 0 black to 1 white in proportion to radiance, a value a field.
        out: folder, made where it is missing.
        plate: `PlateDesign`.
        names: what the pictures are called, for recipe and page.
        ridges: pitch, draft of the walls and radius of the crests; the ridge angle is chosen for every field.
        material: the plastic; the default one where it is not given.
        make: what is written for the making of the insert.
        on_progress: called along the way of the trial.

    Raises:
        UsageError: numbers that make no plate, or files that exist.
        HeightMapError: fields that hold no whole ridges or pixels.
    """
    plastic, making, pixel_um, trial = (
        material or Material(),
        make or Manufacture(),
        plate.pixel_um,
        plate.trial,
    )
    stages, light_angle_deg = plate.stages_deg[: len(pictures)], plate.light_angle_deg
    if len(stages) != len(pictures):
        raise UsageError(
            f"--angles must name a stage angle a picture, {len(pictures)} of them, not "
            f"{','.join(f'{one:g}' for one in plate.stages_deg)}"
        )
    if len({one.shape for one in pictures}) > 1:
        shapes = " and ".join(f"{one.shape[1]} × {one.shape[0]}" for one in pictures)
        raise UsageError(f"the two pictures have {shapes} fields: give pictures of one shape")
    found = design_pictures(
        np.array(pictures), stages, ridges, plate.field_um, plastic, light_angle_deg, plate.class_count
    )
    _check(making, found.plan, ridges, pixel_um)
    if trial:
        check_trial(found.plan)
    shown = [f"predicted-{stage:g}.png" for stage in stages]
    seen = [f"camera-{stage:g}.png" for stage in stages] if trial else []
    files = ["plan.csv", "fields.csv", "recipe.toml", "appearance.html", *shown, *seen, *making.names()]
    _new_folder(out, files, overwrite=plate.overwrite)
    length_m, minutes = _write(making, out, found.plan, ridges, pixel_um)
    (out / "fields.csv").write_text(_fields_text(found.plan), encoding="utf-8")
    tables = recipe_of(found.plan, ridges, f"plate that shows {' and '.join(names[: len(pictures)])}")
    lobe: dict[str, Any] = _lobe(plastic)
    tables |= {"material": lobe, "poses": {"angles_deg": inspected_at(stages)}}
    (out / "recipe.toml").write_text(recipe_text(tables), encoding="utf-8")
    kind_named("plates").read_recipe(out / "recipe.toml")
    title = " and ".join(Path(name).stem for name in names[: len(pictures)])
    ends = found.black, found.white
    write_plate_page(
        out / "appearance.html",
        title,
        found.plan,
        ridges,
        plastic,
        light_angle_deg,
        stages,
        ends,
        found.shown[0],
    )
    for name, one in zip(shown, found.shown, strict=True):
        _write_picture(out / name, one, ends)
    camera = tried = None
    if trial:
        tried = photograph(out, found.plan, ridges, lobe, on_progress)
        photographs = tried.radiance[: len(stages)]
        for name, one in zip(seen, photographs, strict=True):
            _write_picture(out / name, one, ends)
        camera = Likeness(*found.likeness(photographs))
    return DesignedPlate(
        found,
        light_angle_deg,
        Likeness(*found.likeness()),
        camera,
        length_m,
        minutes,
        tuple(out / name for name in files),
        tried,
    )


def read_grey(path: Path, fields: int | None = None, tone: Tone = "linear") -> FloatArray:
    """A picture as greys from 0 to 1, in proportion to radiance.

    Args:
        path: image file.
        fields: values along the longer side; one a pixel where it is left out.
        tone: whether its greys are linear, or sRGB (IEC 61966-2-1).

    Raises:
        UsageError: it cannot be read.
    """
    content = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.zeros(0, np.uint8)
    decoded = cv2.imdecode(content, cv2.IMREAD_GRAYSCALE) if content.size else None
    if decoded is None:
        raise UsageError(f"{path}: there is no such picture, or it cannot be read")
    grey = np.asarray(decoded, dtype=np.float64) / 255.0
    if tone == "srgb":
        grey = np.where(grey <= 0.04045, grey / 12.92, ((grey + 0.055) / 1.055) ** 2.4)
    if fields is None:
        return grey
    if fields < 1:
        raise UsageError(f"--field-count must be 1 or more, not {fields}")
    scale = fields / max(grey.shape)
    size = tuple(max(1, round(scale * n)) for n in grey.shape[::-1])
    return np.asarray(cv2.resize(grey, (size[0], size[1]), interpolation=cv2.INTER_AREA))


def _lobe(material: Material) -> dict[str, Any]:
    """Table of the plastic in recipe and bench file."""
    index = {} if material.index == Material().index else {"index": material.index}
    return {name: getattr(material, name) for name in ("alpha_along", "alpha_across", "albedo")} | index


def _fields_text(plan: Plan) -> str:
    tail = {one: f"{one},{plan.azimuths_deg[one]:g},{plan.ridge_angles_deg[one]:g}\n" for one in plan.letters}
    lines = [f"{row},{col},{tail[one]}" for row, text in enumerate(plan.rows) for col, one in enumerate(text)]
    return "row,column,class,facet_azimuth_deg,ridge_angle_deg\n" + "".join(lines)


def _write_picture(path: Path, radiance: FloatArray, ends: tuple[float, float]) -> None:
    """Write radiances as grey levels from black to white."""
    grey = np.clip((radiance - ends[0]) / (ends[1] - ends[0]), 0.0, 1.0)
    cv2.imwrite(str(path), np.rint(255.0 * grey).astype(np.uint8))


@dataclass(frozen=True)
class CodePose:
    """A predicted code at one stage angle.

    Attributes:
        stage_deg: stage angle.
        light: radiance of the brighter modules, 1/sr.
        dark: of the darker ones.
        inverted: whether light modules are the darker ones.
        reads: what the predicted picture says; None where nothing is read.
        grades: after ISO/IEC 29158 and 15415, the overall one first.
    """

    stage_deg: float
    light: float
    dark: float
    inverted: bool
    reads: str | None
    grades: tuple[Grade, ...]


@dataclass(frozen=True)
class DesignedCode:
    """A plate that says a code.

    Attributes:
        text: what it says.
        symbology: kind of code.
        plan: its fields.
        poses: at the angles at which it is read.
        cut_length_m: length of the cuts of the insert; None without a path.
        cut_minutes: time of its program, without acceleration.
        files: written files.
        trial: the inspection on the virtual rig.
    """

    text: str
    symbology: Symbology
    plan: Plan = field(metadata=LEFT_OUT)
    poses: tuple[CodePose, ...]
    cut_length_m: float | None
    cut_minutes: float | None
    files: tuple[Path, ...]
    trial: Trial | None

    @property
    @in_json()
    def modules(self) -> tuple[int, int]:
        """(rows, cols), with the quiet zone."""
        return self.plan.shape

    @property
    @in_json()
    def size_mm(self) -> tuple[float, float]:
        """(wide, high)."""
        return self.plan.size_mm


@by_keywords(code=CodeDesign)
def design_code(
    text: str,
    out: Path,
    *,
    code: CodeDesign,
    ridges: RidgeDesign = CODE_RIDGES,
    make: Manufacture | None = None,
    on_progress: Advance = silent,
) -> DesignedCode:
    """Make a code of ridges in two directions, which exchange light and dark when turned: ``anisoscope design code``.

    Writes plan.csv, recipe.toml, height maps of part and insert and appearance.html into a folder, and what ``make``
    asks for.

    Args:
        text: what the code says.
        out: folder, made where it is missing.
        code: `CodeDesign`.
        ridges: of the fields.
        make: what is written for the making of the insert.
        on_progress: called along the way of the trial.

    Raises:
        UsageError: a text that no code or plate holds, or files that exist.
        HeightMapError: modules that hold no two ridges or no whole pixels.
    """
    making, symbology, plate_mm = make or Manufacture(), code.symbology, code.plate_mm
    light, dark = code.facet_azimuths_deg
    plan = plan_of_modules(modules_of_code(text, symbology), code.module_mm, (light, dark))
    plan.check_ridges(ridges.pitch_um)
    if plate_mm is not None and max(plan.size_mm) > plate_mm * (1.0 + 1e-9):
        shown = text if len(text) <= SHOWN else f"{text[:SHOWN]}…"
        raise UsageError(
            f"{shown!r} needs {len(plan.rows)} × {len(plan.rows)} modules with its quiet zone, {plan.size_mm[0]:g} mm "
            f"of {code.module_mm:g} mm each; the plate has {plate_mm:g} mm: make modules of at most "
            f"{plate_mm / len(plan.rows):.3g} mm, or the text shorter"
        )
    _check(making, plan, ridges, code.pixel_um)
    if code.trial:
        check_trial(plan)
    names = ["plan.csv", "recipe.toml", "appearance.html", *making.names()]
    _new_folder(out, names, overwrite=code.overwrite)
    length_m, minutes = _write(making, out, plan, ridges, code.pixel_um)
    tables = recipe_of(plan, ridges, f"{symbology} {text} of ridges")
    tables["code"] = {"text": text, "symbology": symbology, "read_at_deg": list(READ_AT_DEG)}
    (out / "recipe.toml").write_text(recipe_text(tables), encoding="utf-8")
    recipe = kind_named("plates").read_recipe(out / "recipe.toml")
    assert isinstance(recipe, PlateRecipe)
    expected = expected_plate(recipe, plan, LIGHT_DEG, cached=True)
    ends = float(expected.radiance.min()), float(expected.radiance.max())
    title, plastic = f"{symbology} {text}", recipe.material.material()
    write_plate_page(out / "appearance.html", title, plan, ridges, plastic, LIGHT_DEG, READ_AT_DEG, ends)
    tried = photograph(out, plan, ridges, _lobe(plastic), on_progress) if code.trial else None
    readings, grades = predicted_code(expected, symbology)
    poses = tuple(
        CodePose(
            pose.stage_deg,
            float(expected.radiance[:, number].max()),
            float(expected.radiance[:, number].min()),
            int(np.argmin(expected.radiance[:, number])) == 0,
            readings[number],
            tuple(grades[number]),
        )
        for number, pose in enumerate(expected.poses)
        if pose.stage_deg in READ_AT_DEG
    )
    files = tuple(out / name for name in names)
    return DesignedCode(text, symbology, plan, poses, length_m, minutes, files, tried)


def _check(make: Manufacture, plan: Plan, design: RidgeDesign, pixel_um: float) -> None:
    """Check that all can be made, before anything is written."""
    points = plan.shape[0] * plan.shape[1] * plan.points(pixel_um) ** 2
    if points > MOST_POINTS:
        raise UsageError(
            f"a map of {points / 1e6:.0f} million points is too large (at most {MOST_POINTS / 1e6:.0f}): take "
            "fewer fields, or a larger --pixel"
        )
    for letter in plan.letters:
        check_mould(plan.design_of(letter, design), _tool(make, design) if make.path else None)


def _tool(make: Manufacture, design: RidgeDesign) -> Tool:
    return Tool(design.edge_radius_um, make.tool_half_angle_deg, make.feed)


def _write(
    make: Manufacture, out: Path, plan: Plan, design: RidgeDesign, pixel_um: float
) -> tuple[float, float] | tuple[None, None]:
    """Write the plan and the files of the insert; length of the cuts in m and their time in minutes with a path."""
    (out / "plan.csv").write_text("".join(f"{','.join(row)}\n" for row in plan.rows), encoding="utf-8")
    surface = plate_map(plan, design, pixel_um, drafted=True)
    for side in ("part", "insert"):
        if side == "insert":
            surface = turned_over(surface)
        for suffix in (".x3p", ".npz") if make.npz else (".x3p",):
            write_height_map(surface, out / f"{side}{suffix}")
    del surface
    body = Body(plan, design, 1000.0 * make.base_mm)
    if make.stl:
        write_body(body, out / "part.stl", "part")
        write_body(body, out / "insert.stl", "insert")
    if not make.path:
        return None, None
    cuts = insert_path(body, _tool(make, design))
    write_passes(cuts, out / "insert-passes.csv", out / "insert-fields.csv")
    write_gcode(cuts, out / "insert.nc")
    return cuts.length_m, cuts.minutes


def _new_folder(out: Path, names: list[str], *, overwrite: bool) -> None:
    """Make the folder of a design.

    Raises:
        UsageError: files exist, or the folder cannot be made.
    """
    existing = [name for name in names if (out / name).exists()]
    if existing and not overwrite:
        raise UsageError(f"{out / existing[0]} exists; give another folder, or --overwrite")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise UsageError(f"cannot make the folder {out}: {problem.strerror}") from None


def recipe_of(plan: Plan, design: RidgeDesign, product: str) -> dict[str, object]:
    """Tables of a recipe with its plan in ``plan.csv``; plastic and exposure are to be adapted.

    It has no tolerance of the classes: with an unmeasured lobe u of their ln ratios is so large that within a
    tolerance of use good plates would end undecided. Without one, significant deviations fail.
    """
    angle = design.ridge_angle_deg
    ridges: dict[str, object] = {"ridge_angle_deg": angle, "u_ridge_angle_deg": 0.1}
    if not isinstance(design.wall, str):
        ridges["wall"] = design.wall
    if design.edge_radius_um > 0.0:
        ridges["edge_radius_um"] = design.edge_radius_um
    if design.foot_radius_um > 0.0:
        ridges["foot_radius_um"] = design.foot_radius_um
    fields: dict[str, object] = {
        "file": "plan.csv",
        "module_mm": plan.module_mm,
        "facet_azimuths_deg": dict(plan.azimuths_deg),
    }
    if plan.ridge_angles_deg:
        fields["ridge_angles_deg"] = dict(plan.ridge_angles_deg)
    return {
        "schema": 1,
        "kind": "plates",
        "product": product,
        "surface": {"pitch_um": design.pitch_um, "design": ridges},
        "material": {"alpha_along": 0.06, "alpha_across": 0.10, "albedo": 0.2},
        "plan": fields,
        "poses": {"angles_deg": inspected_at((0.0, 90.0))},
        "acquisition": {"exposure_s": 0.006},
        "region": {"size_mm": [round(one, 6) for one in plan.size_mm]},
        "decision": {"unexcluded": "inconclusive"},
    }


def inspected_at(stages_deg: tuple[float, ...]) -> list[float]:
    """Stage angles of an inspection: those at which a plate is looked at, and others until there are three.

    Worn and filled ridges shine after half a turn, where good ones face away.
    """
    others = [stages_deg[0] + turn for turn in (180.0, 90.0)]
    others = [one for one in others if all((one - seen) % 360.0 for seen in stages_deg)]
    return [*stages_deg, *sorted(others[: MOST_ANGLES - len(stages_deg)])]


def recipe_text(tables: dict[str, object]) -> str:
    """Text of a recipe to begin with."""
    import tomli_w

    head = (
        "# Recipe of a plate of ridges. To be adapted: [material] (its lobe is unmeasured here), [acquisition] and\n"
        "# [fields]; `anisoscope recipe check` reads it. As written every significant deviation fails; a [decision]\n"
        "# tolerance takes a calibrated material or golden plates, or good plates end undecided.\n"
    )
    return head + tomli_w.dumps(tables)

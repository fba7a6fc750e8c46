"""Guided work at a station: what to put on the stage, a button, what was found; then the next step.

A guide is a form and steps. What a step does is a function of the commands, carried out where inspections are; a step
may also be an inspection. Where a guide stands is in a file, so that the end of the server does not end a study.
"""

import contextlib
import math
import random
import re
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import AnisoscopeError, UsageError
from anisoscope.base.json_fields import as_json
from anisoscope.base.language import decimal, message, translated
from anisoscope.base.progress import Advance
from anisoscope.base.regular_file import bounded_text
from anisoscope.console.access import Permission
from anisoscope.inspection.recipe_store import RecipeEntry, recipe_entry, recipe_path
from anisoscope.inspection.work import Workplace

if TYPE_CHECKING:
    from anisoscope.calibration.record import CalibrationRecord

STATE = "guide.json"
MOST_STEPS = 1000

Key = Literal["flat", "rotation", "fixture", "commissioning", "golden", "gauge", "material", "focus"]
Rows = Sequence[Sequence[str]]


@dataclass(frozen=True)
class Outcome:
    """Result of a step: whether it may go on, rows of a table, and notes."""

    good: bool
    rows: Rows = ()
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Step:
    """Step of guided work: the operator's task at the stage, and the action then.

    Attributes:
        ask: what to put on the stage, in the language of the reader.
        work: what is done, in the process of the inspections; None inspects a part.
        serial, operator: of the part to inspect.
    """

    ask: str
    work: Callable[[Workplace, Advance], Outcome] | None = None
    serial: str = ""
    operator: str = ""


@dataclass(frozen=True)
class Entry:
    """A field of a form: its name, its words, and what it has at first; a number has one."""

    name: str
    words: str
    value: str | float = ""
    needed: bool = True


@dataclass(frozen=True)
class Guide:
    """One thing that is done by steps.

    Attributes:
        title, about: in the language of the reader.
        entries: of its form, behind recipe and reason.
        steps: from what was entered, and from the state.
        needs: what one has to be allowed.
        blind: whether verdicts are shown only at the end.
    """

    title: str
    about: str
    entries: Sequence[Entry]
    steps: "Callable[[Entered, GuideState], list[Step]]"
    needs: Permission = "operate"
    blind: bool = False


class GuideState(BaseModel):
    """State of a guide; ``results`` has a row of tables for each finished step."""

    model_config = ConfigDict(extra="forbid")

    key: Key
    recipe: str
    values: dict[str, str | float]
    who: str
    why: str
    seed: int
    at: int = 0
    results: list[dict[str, Any]] = Field(default_factory=list)
    folders: list[str] = Field(default_factory=list)


class Begin(BaseModel):
    """Request to begin guided work: its name, values and reason."""

    model_config = ConfigDict(extra="forbid")

    key: Key
    recipe: str = Field(max_length=200)
    values: dict[str, str | float] = Field(max_length=20)
    why: str = Field(min_length=1, max_length=500, pattern=r"\S")


@dataclass(frozen=True)
class Entered:
    """Fields of a form, read and checked."""

    recipe: Path
    entry: RecipeEntry
    values: Mapping[str, str | float]
    who: str

    def number(self, name: str) -> float:
        """A number above 0.

        Raises:
            UsageError: it is none.
        """
        found = self._value(name)
        if not 0.0 < found < float("inf"):
            raise UsageError(f"{name} takes a number above 0, not {str(self.values.get(name, ''))[:40]!r}")
        return found

    def reading(self, name: str) -> float:
        """A reading of an axis, of either sign.

        Raises:
            UsageError: it is none.
        """
        found = self._value(name)
        if not math.isfinite(found):
            raise UsageError(f"{name} takes a number, not {str(self.values.get(name, ''))[:40]!r}")
        return found

    def _value(self, name: str) -> float:
        """Value of a field, NaN if it is no number."""
        try:
            return float(self.values[name])
        except (KeyError, ValueError):
            return math.nan

    def names(self, name: str, least: int) -> list[str]:
        """Names with commas between them, each once.

        Raises:
            UsageError: too few, or one twice.
        """
        found = [one.strip() for one in str(self.values.get(name, "")).split(",") if one.strip()]
        if len(found) < least or len(set(found)) < len(found) or len(found) > MOST_STEPS:
            raise UsageError(f"{name} takes at least {least} names with commas between them, each once")
        return found

    def optional(self, name: str) -> str | None:
        """A text, or None where it was left empty."""
        return str(self.values.get(name, "")).strip() or None


def entered(recipes: Path, given: "Begin | GuideState", who: str) -> Entered:
    """Form fields.

    Raises:
        UsageError: there is no such recipe, or it cannot be used.
    """
    path = recipe_path(recipes, given.recipe)
    entry = recipe_entry(path)
    if entry.problem is not None:
        raise UsageError(entry.problem)
    return Entered(path, entry, given.values, who)


def begun(recipes: Path, given: Begin, who: str) -> GuideState:
    """The state of a guide that begins.

    Raises:
        UsageError: there is no such guide, or what was entered cannot be used.
    """
    guide = guides()[given.key]
    missing = [
        one.words for one in guide.entries if one.needed and not str(given.values.get(one.name, "")).strip()
    ]
    if missing:
        raise UsageError(f"{missing[0]}: nothing was entered")
    state = GuideState(**given.model_dump(), who=who, seed=secrets.randbits(32))
    guide.steps(entered(recipes, given, who), state)
    return state


class Guided:
    """The guided work of a station, one at a time; it goes on after the end of the server.

    Args:
        out: folder of the inspections, which has its file.
        recipes: folder of the recipes.

    Attributes:
        state: where it stands; None without one.
    """

    def __init__(self, out: Path, recipes: Path) -> None:
        self._file, self._recipes = out / STATE, recipes
        self.state: GuideState | None = None
        with contextlib.suppress(OSError, UnicodeError, ValidationError, AnisoscopeError):
            found = GuideState.model_validate_json(bounded_text(self._file))
            if found.at < len(self._steps(found)):
                self.state = found

    @property
    def guide(self) -> Guide | None:
        """The work that is at hand."""
        return None if self.state is None else guides()[self.state.key]

    def recipe(self) -> Path:
        """Its recipe; errors as for `entered`."""
        assert self.state is not None
        return recipe_path(self._recipes, self.state.recipe)

    def begin(self, given: Begin, who: str) -> None:
        """Begin; errors as for `begun`."""
        self.state = begun(self._recipes, given, who)
        self._write()

    def end(self) -> None:
        """End it, finished or not; files that its steps wrote stay."""
        self.state = None
        self._file.unlink(missing_ok=True)

    def step(self) -> Step:
        """The step that is next.

        Raises:
            UsageError: there is none.
        """
        steps = [] if self.state is None else self._steps(self.state)
        if self.state is None or self.state.at >= len(steps):
            raise UsageError(message("there is no step to do"))
        return steps[self.state.at]

    def has_done(self, outcome: Outcome, folder: str = "") -> None:
        """Note what a step found; the next one follows a good one, others are done again."""
        assert self.state is not None
        self.state.results.append({"step": self.state.at + 1, **as_json(outcome)})
        if outcome.good:
            self.state.at += 1
            self.state.folders += [folder] * bool(folder)
        self._write()

    def shown(self, state: GuideState | None) -> dict[str, Any] | None:
        """A state of guided work for its page, in the language of the reader."""
        if state is None:
            return None
        steps, at = self._steps(state), state.at
        results = [
            one
            | {
                "rows": [[translated(cell) for cell in row] for row in one["rows"]],
                "notes": [translated(note) for note in one["notes"]],
            }
            for one in state.results[-8:]
        ]
        return {
            "title": guides()[state.key].title,
            "at": at,
            "of": len(steps),
            "ask": steps[at].ask if at < len(steps) else "",
            "results": results,
        }

    def _steps(self, state: GuideState) -> list[Step]:
        return guides()[state.key].steps(entered(self._recipes, state, state.who), state)

    def _write(self) -> None:
        assert self.state is not None
        self._file.parent.mkdir(parents=True, exist_ok=True)
        write_text(self._file, self.state.model_dump_json())


def described(rig: Path) -> list[dict[str, Any]]:
    """All guides that a rig has the axes for, for their forms."""
    from anisoscope.rig.rigfile import read_rig

    focuses = read_rig(rig).z is not None
    return [
        {
            "key": key,
            "title": guide.title,
            "about": guide.about,
            "needs": guide.needs,
            "entries": [
                {
                    "name": one.name,
                    "words": one.words,
                    "value": one.value,
                    "number": isinstance(one.value, float),
                    "needed": one.needed,
                }
                for one in guide.entries
            ],
        }
        for key, guide in guides().items()
        if key != "focus" or focuses
    ]


# What the steps do.


def _calibration_file(rig: Path, kind: str, name: str) -> tuple[Path, list[str]]:
    """The file that a rig names for a calibration, or one next to it, and what is to be said then."""
    from anisoscope.rig.rigfile import read_rig

    part = read_rig(rig).calibration
    named: Path | None = None if part is None else getattr(part, kind)
    if named is not None:
        return named, []
    path = rig.parent / name
    return path, [
        message("Name {path} in the rig file under [calibration] {kind}.", path=path.name, kind=kind)
    ]


def _calibrated(record: "CalibrationRecord", notes: Sequence[str]) -> Outcome:
    rows = [
        (name.replace("_", " "), f"{one.value:.4g} {one.unit}", "" if one.u is None else f"u {one.u:.2g}")
        for name, one in record.values.items()
    ]
    return Outcome(record.in_limits, rows, (*notes, *record.remarks))


def take_flat(place: Workplace, advance: Advance, *, taking: Any, reflectance: float) -> Outcome:  # noqa: ANN401
    """White reference, as `anisoscope calibrate flat`."""
    from anisoscope.calibration.pictures import calibrate_flat

    path, notes = _calibration_file(place.rig, "flat", "flat.tif")
    _, record = calibrate_flat(place.rig, path, taking, reflectance=reflectance, on_progress=advance)
    return _calibrated(record, notes)


def take_dark(place: Workplace, advance: Advance, *, taking: Any) -> Outcome:  # noqa: ANN401
    """Dark frames, as `anisoscope calibrate dark`."""
    from anisoscope.calibration.pictures import calibrate_dark

    path, notes = _calibration_file(place.rig, "dark", "dark.json")
    return _calibrated(calibrate_dark(place.rig, path, taking, on_progress=advance), notes)


def find_rotation(place: Workplace, advance: Advance, *, taking: Any) -> Outcome:  # noqa: ANN401
    """Rotation centre, as `anisoscope calibrate rotation`."""
    from anisoscope.calibration.rotation import calibrate_rotation

    path, notes = _calibration_file(place.rig, "rotation", "rotation.json")
    return _calibrated(calibrate_rotation(place.rig, path, taking, on_progress=advance), notes)


def teach_fixture(
    place: Workplace,
    advance: Advance,
    *,
    recipe: Path,
    taking: Any,  # noqa: ANN401
    write: bool = False,
    needed: bool = True,
) -> Outcome:
    """White, black and greys of the fixture at the tilts of a recipe, as `anisoscope calibrate fixture`.

    Args:
        place: with the rig.
        advance: progress.
        recipe: the recipe.
        taking: exposure, gain and frames.
        write: name the reference in the rig file.
        needed: a rig without markers or flat is an error; else a note.
    """
    from anisoscope.calibration.fixture import calibrate_fixture
    from anisoscope.commissioning.commissioning import teach_fixture as taught
    from anisoscope.commissioning.commissioning import tilts_of
    from anisoscope.kinds.recipes import read_any_recipe
    from anisoscope.rig.rigfile import read_rig

    file = read_rig(place.rig, channel=taking.light_channel)
    if not needed and (file.fixture is None or file.calibration is None):
        return Outcome(
            True, (), (message("The rig file names no fixture or no flat: no markers are taught."),)
        )
    tilts = tilts_of(place.rig, read_any_recipe(recipe))
    if write:
        return _calibrated(taught(place.rig, taking, tilts=tilts, on_progress=advance).record, ())
    path, notes = _calibration_file(place.rig, "fixture", "fixture.json")
    return _calibrated(calibrate_fixture(place.rig, path, taking, tilts=tilts, on_progress=advance), notes)


def commission_rig(place: Workplace, advance: Advance, *, recipe: Path, entry: RecipeEntry) -> Outcome:
    """Geometry of the rig, as `anisoscope rig commission`."""
    from anisoscope.commissioning.commissioning import commission, part_of_recipe
    from anisoscope.commissioning.record import default_record_path, write_commissioning
    from anisoscope.commissioning.series import Series
    from anisoscope.kinds.registry import read_recipe
    from anisoscope.report.commission_page import finding_row

    part = part_of_recipe(read_recipe(recipe), None, 0.1)
    series = Series(entry.exposure_s, entry.gain, light_channel=entry.channel)
    done = commission(place.rig, part, series, on_progress=advance)
    write_commissioning(done.record, default_record_path(place.rig))
    rows = [
        (translated(words), f"{old} → {translated(value)} {unit}", f"u {u}")
        for words, _, unit, old, value, u, _ in map(finding_row, done.record.findings)
    ]
    return Outcome(True, rows, tuple(map(translated, done.record.notes)))


def write_findings(place: Workplace, advance: Advance) -> Outcome:
    """Write the findings of commissioning into the rig file, as `anisoscope rig commission --write`."""
    from anisoscope.commissioning.commissioning import write_to_rig_file
    from anisoscope.commissioning.record import default_record_path, read_commissioning

    del advance
    written = write_to_rig_file(place.rig, read_commissioning(default_record_path(place.rig)))
    if written is None:
        return Outcome(True, (), (message("the rig file states all this already"),))
    text = message(
        "{path} was updated; the old file is {file}", path=place.rig.name, file=written.backup.name
    )
    return Outcome(True, (), (text, message("Start the console again: it has the rig open by the old file.")))


def add_golden_parts(place: Workplace, advance: Advance, *, recipe: Path, folders: Sequence[str]) -> Outcome:
    """Inspected parts to the golden parts, as `anisoscope golden add`."""
    from anisoscope.kinds.registry import add_golden

    del advance
    known, failed, _ = add_golden(recipe, [place.out / name for name in folders])
    notes = [
        message(
            "The verdict of {serials} was FAIL: are these parts good?",
            serials=", ".join(failed),
        )
    ]
    rows = [(message("golden parts"), str(len(known.parts)))]
    return Outcome(True, rows, (*(notes if failed else ()), *((known.lacking,) if known.lacking else ())))


def judge_gauge(
    place: Workplace,
    advance: Advance,
    *,
    runs: Sequence[tuple[str, str, str]],
    number: str | None,
    tolerance: float | None,
) -> Outcome:
    """Gauge R&R of inspections, as `anisoscope msa gauge`.

    Args:
        place: where they are.
        advance: progress.
        runs: part, appraiser and folder of each.
        number: which number; None takes the first.
        tolerance: width between the limits of good parts.
    """
    from datetime import UTC

    from anisoscope.history.rows import row_of
    from anisoscope.quality.gauge import gauge_data, gauge_study
    from anisoscope.quality.readings import Readings
    from anisoscope.record.schema import read_record
    from anisoscope.report.msa_page import components

    found = []
    for done, (_, _, folder) in enumerate(runs):
        advance("records", done, len(runs))
        found.append(row_of(read_record(place.out / folder), place.out / folder).numbers)
    names = [name for name in found[0] if not name.startswith(("u ", "deviation ", "tolerance ", "cause "))]
    numbers = {name: np.array([one.get(name, np.nan) for one in found]) for name in names}
    texts = {"part": tuple(run[0] for run in runs), "appraiser": tuple(run[1] for run in runs)}
    study = gauge_study(gauge_data(Readings("the study", texts, numbers, UTC), number), tolerance)
    table = components(study)
    return Outcome(study.usable, [table.columns, *table.rows], study.notes)


def scan_material(place: Workplace, advance: Advance, *, recipe: Path, name: str, who: str) -> Outcome:
    """Material of a flat piece, as `anisoscope calibrate material --coupon`."""
    from anisoscope.inspection.material_calibration import (
        calibrate_material,
        scan_setup,
        scan_specimen,
    )

    setup = scan_setup(place.rig, recipe, "coupon")
    scan, camera = scan_specimen(setup, place.rig, recipe, advance)
    out = place.out / "materials" / f"{name}.toml"
    out.parent.mkdir(parents=True, exist_ok=True)
    file, found = calibrate_material(
        setup, scan, out, name=name, camera=camera, operator=who, on_progress=advance
    )
    rows = [(message("albedo"), f"{file.material.albedo:.4g}")]
    return Outcome(found.fits, rows, (message("record: {path}", path=out),))


def find_focus(place: Workplace, advance: Advance, *, entry: RecipeEntry, low: float, high: float) -> Outcome:
    """Focus by the axis z, as `anisoscope rig focus`; the axis stays there."""
    from anisoscope.live_view.autofocus import Autofocus
    from anisoscope.rig.acquisition.opening import open_devices
    from anisoscope.rig.rigfile import read_rig

    file = read_rig(place.rig, channel=entry.channel)
    if file.z is None:
        raise UsageError("nothing moves the focus there: the rig file has no table [z]")
    axes = file.moved_with("z")
    with open_devices(axes, file.camera, file.light, rows_of=file) as devices:
        for table in dict.fromkeys((*file.home_order, *axes)):
            if table in axes and not devices.axes[table].is_homed:
                advance(f"home {table}", 0, 1)
                devices.axes[table].home()
        assert devices.camera is not None
        devices.camera.configure(entry.exposure_s, entry.gain)
        if devices.light is not None:
            devices.light.on()
        search = Autofocus(devices.axes["z"], devices.camera, file.z.approach_mm, on_progress=advance)
        found = search.search(low, high)
    notes = (
        message("z in focus at {place}", place=decimal(f"{found.reached:.4f} mm")),
        message(
            "repeatable within {size} (standard deviation of {count} sweeps)",
            size=decimal(f"{1000.0 * found.repeatability:.2g} µm"),
            count=len(found.places),
        ),
        message("half as sharp {size} away", size=decimal(f"{1000.0 * found.half_width:.3g} µm")),
    )
    return Outcome(True, (), notes)


# The guides.


def _taking(asked: Entered, frames: int) -> Any:  # noqa: ANN401
    from anisoscope.parameters.taking import Taking

    entry = asked.entry
    return Taking(entry.exposure_s, entry.gain, frames, operator=asked.who, light_channel=entry.channel)


def _flat_and_dark(asked: Entered, _: GuideState) -> list[Step]:
    flat = partial(take_flat, taking=_taking(asked, 16), reflectance=asked.number("reflectance"))
    return [
        Step(
            message(
                "Place the white tile on the stage so that it fills the picture. The stage does not move."
            ),
            flat,
        ),
        Step(
            message("The light goes off by itself; keep other light away."),
            partial(take_dark, taking=_taking(asked, 32)),
        ),
        Step(
            _seat_fixture(),
            partial(teach_fixture, recipe=asked.recipe, taking=_taking(asked, 4), needed=False),
        ),
    ]


def _rotation(asked: Entered, _: GuideState) -> list[Step]:
    text = message("Seat the fixture. The stage homes and turns by a full turn: keep its path free.")
    return [Step(text, partial(find_rotation, taking=_taking(asked, 2)))]


def _seat_fixture() -> str:
    return message(
        "Seat the fixture, empty or with a part; lamp and room as in inspections. The stage homes and turns by a full "
        "turn: keep its path free."
    )


def _fixture(asked: Entered, _: GuideState) -> list[Step]:
    return [Step(_seat_fixture(), partial(teach_fixture, recipe=asked.recipe, taking=_taking(asked, 2)))]


def _commissioning(asked: Entered, _: GuideState) -> list[Step]:
    find = partial(commission_rig, recipe=asked.recipe, entry=asked.entry)
    return [
        Step(
            message("Place the known part of the recipe on the stage. All axes move: keep their paths free."),
            find,
        ),
        Step(
            message("Write what was found into the rig file? The old file stays; End leaves it as it is."),
            write_findings,
        ),
        Step(
            _seat_fixture(),
            partial(teach_fixture, recipe=asked.recipe, taking=_taking(asked, 4), write=True, needed=False),
        ),
    ]


def _golden(asked: Entered, state: GuideState) -> list[Step]:
    from anisoscope.inspection.job import check_serial

    parts = [
        Step(message("Place the good part {serial} on the stage.", serial=one), serial=check_serial(one))
        for one in asked.names("parts", 2)
    ]
    add = partial(add_golden_parts, recipe=asked.recipe, folders=tuple(state.folders))
    return [*parts, Step(message("Add these parts to the golden parts of the recipe? Nothing moves."), add)]


def _gauge(asked: Entered, state: GuideState) -> list[Step]:
    from anisoscope.inspection.job import check_serial

    parts, appraisers = asked.names("parts", 2), asked.names("appraisers", 1)
    trials, order = round(asked.number("trials")), random.Random(state.seed)  # noqa: S311 - an order, no secret
    if not 2 <= trials <= 20 or trials * len(parts) * len(appraisers) > MOST_STEPS:
        raise UsageError(f"a study has 2 to 20 trials, and {MOST_STEPS} measurements at most")
    steps = []
    for _ in range(trials):
        for who in order.sample(appraisers, len(appraisers)):
            for part in order.sample(parts, len(parts)):
                text = message("{who} measures: place part {part} on the stage.", who=who, part=part)
                steps.append(Step(text, serial=check_serial(part), operator=who))
    tolerance = None if asked.optional("tolerance") is None else asked.number("tolerance")
    runs = [(one.serial, one.operator, folder) for one, folder in zip(steps, state.folders, strict=False)]
    judge = partial(judge_gauge, runs=tuple(runs), number=asked.optional("number"), tolerance=tolerance)
    return [*steps, Step(message("All is measured. Nothing moves."), judge)]


def _material(asked: Entered, _: GuideState) -> list[Step]:
    name = str(asked.values["name"]).strip()
    if not re.fullmatch(r"\w[\w.+-]{0,63}", name):
        raise UsageError("the name of a material has 1 to 64 letters, digits and . _ + -")
    scan = partial(scan_material, recipe=asked.recipe, name=name, who=asked.who)
    return [
        Step(
            message("Place a flat piece of the plastic on the stage. All axes move: keep their paths free."),
            scan,
        )
    ]


def _focus(asked: Entered, _: GuideState) -> list[Step]:
    low, high = asked.reading("low"), asked.reading("high")
    if not low < high:
        raise UsageError(message("The sweep goes upwards: the first reading is below the last."))
    find = partial(find_focus, entry=asked.entry, low=low, high=high)
    return [
        Step(
            message(
                "Place the part on the stage. z moves between these readings, and first along its whole travel if it "
                "was not homed: keep its path free."
            ),
            find,
        )
    ]


def guides() -> Mapping[Key, Guide]:
    """All guided work, in the language of the reader."""
    parts = message("Parts: their numbers, with commas")
    return {
        "flat": Guide(
            message("Flat and dark"),
            message("White reference, dark frames and markers, with the exposure of the recipe."),
            (Entry("reflectance", message("Reflectance of the white tile"), 0.99),),
            _flat_and_dark,
        ),
        "rotation": Guide(
            message("Rotation"), message("Rotation centre and size of a pixel."), (), _rotation
        ),
        "fixture": Guide(
            message("Fixture"),
            message("White, black and greys of the markers, by which inspections watch lamp and camera."),
            (),
            _fixture,
        ),
        "commissioning": Guide(
            message("Commissioning"),
            message("Geometry of the rig, from a known ridged part."),
            (),
            _commissioning,
            "set up",
        ),
        "golden": Guide(
            message("Golden parts"),
            message("Parts that are known to be good, against which others are compared."),
            (Entry("parts", parts),),
            _golden,
            "set up",
        ),
        "gauge": Guide(
            message("Gauge R&R"),
            message("Who measures what next, in random order; values are shown at the end."),
            (
                Entry("parts", parts),
                Entry("appraisers", message("Appraisers, with commas")),
                Entry("trials", message("Trials"), 2.0),
                Entry("number", message("Number, such as ln 0-90; the first one if empty"), needed=False),
                Entry(
                    "tolerance", message("Tolerance: width between the limits; may be empty"), needed=False
                ),
            ),
            _gauge,
            blind=True,
        ),
        "material": Guide(
            message("Material"),
            message("Lobe and albedo of the plastic, from a flat piece."),
            (Entry("name", message("Name of the material")),),
            _material,
            "set up",
        ),
        "focus": Guide(
            message("Focus"),
            message("Sweep of z with the exposure of the recipe; it goes to the sharpest picture."),
            (
                Entry("low", message("From: reading of z in mm")),
                Entry("high", message("To: reading of z in mm")),
            ),
            _focus,
        ),
    }

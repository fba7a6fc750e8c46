"""Plates with tolerances, photographed and judged by the hundred: rates of false alarms, of defects found, of grades.

    python tools/plate_campaign.py FOLDER [--plates 1000] [--seed 1] [--kinds missing direction]
    python tools/plate_campaign.py FOLDER --summary [--docs docs/plates.md]

Every plate is a Data Matrix of ridges whose fields differ in ridge angle, roughness, height and place. A batch of
``LOT`` plates shares plastic, seat and the states of its ridges, which the path tracer renders once. The pictures go
through lens, sensor and noise of the virtual rig, and through the measurement and the verdict of an inspection; only
the search of the markers is left out. The height map of plates with a defect, and of one good plate in four, is
predicted too, as a profilometer would see it. A line of JSON a plate is appended to ``plates.jsonl``; a run goes on
where an earlier one ended. Intervals are those of Clopper and Pearson (95 %), as if all plates were independent; those
of a batch have plastic and seat in common.
"""

import argparse
import json
import sys
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy import stats

from anisoscope.base.errors import MeasurementError
from anisoscope.imaging.linearisation import RadianceImage
from anisoscope.imaging.registration.placement import Grid, Placement, View
from anisoscope.kinds.plates.code_grades import OVERALL
from anisoscope.kinds.plates.code_symbol import read_drawn
from anisoscope.kinds.plates.decision import PlateDecision, decide_plate, predicted_code
from anisoscope.kinds.plates.expectation import ExpectedPlate, expected_plate
from anisoscope.kinds.plates.measurement import MeasuredPlate, measure_plate
from anisoscope.kinds.plates.recipe import PlateRecipe
from anisoscope.operations.demo import plates as demo
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.material import Material
from anisoscope.prediction.region_prediction import FieldGrid, predict_fields
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.bench.bench import plastic
from anisoscope.sim.bench.benchfile import MaterialPart, OpticsPart, SensorPart
from anisoscope.sim.bench.optics import image_of_surface, pixel_from_mm, vignette
from anisoscope.sim.bench.plate import FieldDefectPart, PlatePart, PlateSample
from anisoscope.sim.bench.sensor import Sensor
from anisoscope.sim.light.geometry import directions, seating_rotation

LOT = 25
KINDS = (
    ("good",) * 12 + ("missing", "missing", "direction", "direction", "merged", "filled", "worn") + ("worn",)
)
"""Kinds of plates, in turn: more than half of them are good."""
MAP_OF_GOOD = 4
"""Of how many good plates one has its height map predicted; of those with defects all have."""
MAP_STEP = 2
"""Points of the plate, 1 µm apart, to a point of its height map."""
FINE = 2
"""Points of the plate whose mean a camera pixel of several times their size is made from."""
LIGHT_DEG = 10.0
OPTICS = OpticsPart(pixel_um=10.0, blur_um=6.0, axis_px=(0.0, 0.0))
SENSOR = SensorPart(rows=288, cols=288)
EXPOSURE_S, FRAMES = 0.006, 4
MARKS = "<!-- plate campaign -->", "<!-- end of plate campaign -->"
PLACE_PX = 0.03
"""Standard deviation of the registration."""


def recipe(angles_deg: list[float]) -> PlateRecipe:
    """The recipe of the demo, its plan written out."""
    table = demo.recipe() | {"poses": {"angles_deg": angles_deg}}
    table["plan"] = {
        "rows": list(demo.plan_rows()),
        "module_mm": demo.MODULE_MM,
        "facet_azimuths_deg": demo.AZIMUTHS_DEG,
    }
    return PlateRecipe.model_validate(table)


def table_of(seed: int, number: int) -> dict[str, Any]:
    """Plastic, seat and ridges of the lot of a plate."""
    return demo.sample("good", demo.plan_rows(), np.random.default_rng([seed, number // LOT]))


@lru_cache(maxsize=1)
def lot(seed: int, number: int) -> PlateSample:
    """A plate of a lot, whose rendered ridges are at hand for the others."""
    table = table_of(seed, number * LOT)
    made = PlatePart.model_validate(table["plate"])
    return PlateSample(
        made, plastic(MaterialPart(**table["material"])), np.random.default_rng([seed, number])
    )


def defects_of(kind: str, rng: np.random.Generator) -> tuple[FieldDefectPart, ...]:
    """One field with the defect of a kind."""
    rows, cols = len(demo.plan_rows()), len(demo.plan_rows()[0])
    row, col = int(rng.integers(rows)), int(rng.integers(cols))
    return () if kind == "good" else (FieldDefectPart(row=row, col=col, defect=kind),)


def photograph(
    plate: PlateSample, seat: np.ndarray, pose: Pose, sensor: Sensor, rng: np.random.Generator
) -> View:
    """One pose of a plate through lens, sensor and registration."""
    to_light, to_camera = directions((pose,), Convention(light_angle_deg=LIGHT_DEG))
    shown = plate.radiance((to_light @ seat)[0], (to_camera @ seat)[0])[0]
    coarse = cv2.resize(shown, None, fx=1.0 / FINE, fy=1.0 / FINE, interpolation=cv2.INTER_AREA)
    step = FINE * plate.pixel_um[0], FINE * plate.pixel_um[1]
    image, _ = image_of_surface(coarse, step, OPTICS, SENSOR, pose.stage_deg, pose.tilt_deg)
    shade = vignette(OPTICS, SENSOR)
    lamp = 1.0 + OPTICS.lamp_noise * rng.standard_normal()
    electrons = ((image + OPTICS.stray_radiance) * shade * OPTICS.electrons * EXPOSURE_S * lamp).astype(float)
    frames = np.array([sensor.expose(electrons, EXPOSURE_S, 1.0) for _ in range(FRAMES)], dtype=float)
    dark = np.mean([sensor.expose(np.zeros_like(electrons), EXPOSURE_S, 1.0) for _ in range(8)], axis=0)
    scale = SENSOR.gain_e_per_dn / (OPTICS.electrons * EXPOSURE_S) / shade
    value = ((frames.mean(axis=0) - dark) * scale).astype(np.float32)
    noise = (frames.std(axis=0, ddof=1) * scale / np.sqrt(FRAMES)).astype(np.float32)
    matrix = pixel_from_mm(OPTICS, SENSOR, pose.stage_deg, pose.tilt_deg)
    matrix[:, 2] += PLACE_PX * rng.standard_normal(2)
    place = Placement(
        matrix, pose.stage_deg, OPTICS.pixel_um, (float(matrix[0, 2]), float(matrix[1, 2])), 0.02, 4
    )
    full = frames.max(axis=0) >= sensor.full_scale
    share = float(np.percentile(frames.mean(axis=0) - dark, 99.0) / sensor.full_scale)
    return View(pose.stage_deg, pose.tilt_deg, RadianceImage(value, noise, full, share, frames=FRAMES), place)


def plate(
    number: int, seed: int, kinds: tuple[str, ...], recipe_: PlateRecipe, expected: ExpectedPlate
) -> dict[str, Any]:
    """One plate of the campaign: what it is, what was measured, and what its height map predicts."""
    lot_table, rng = table_of(seed, number), np.random.default_rng([seed, number, 1])
    kind = kinds[number % len(kinds)]
    defects = defects_of(kind, rng)
    made = lot(seed, number // LOT).lot_mate(rng, defects)
    seat = seating_rotation(*lot_table["seating_tilt_deg"])
    sensor = Sensor(SENSOR, rng)
    views = [photograph(made, seat, pose, sensor, rng) for pose in expected.poses]
    found: dict[str, Any] = {"number": number, "kind": kind}
    found["field"] = [[one.row, one.col] for one in defects]
    try:
        seen = measure_plate(views, None, recipe_, expected, OPTICS.pixel_um)
    except MeasurementError as problem:
        return found | {"invalid": str(problem)}
    found |= {
        "radiance": rounded(seen.radiance),
        "u_place": rounded(seen.u_place),
        "noise": rounded(seen.noise),
    }
    found |= {"alike": seen.alike, "texts": list(seen.texts)}
    found["places"] = [
        None if one is None else [*one.shift, one.turn_deg, one.axial, one.grid] for one in seen.places
    ]
    if kinds == KINDS and (kind != "good" or number % MAP_OF_GOOD == 0):
        found["map"] = rounded(of_map(made, recipe_, expected))
    return found


def of_map(made: PlateSample, recipe_: PlateRecipe, expected: ExpectedPlate) -> np.ndarray:
    """(P, rows, cols) radiance that the height map of a plate predicts, by the nominal plastic."""
    nominal = Material(*(demo.LOBE[name] for name in ("alpha_along", "alpha_across", "albedo", "index")))
    plan = recipe_.plan.plan()
    azimuths = tuple(plan.azimuths_deg[letter] for letter in plan.letters)
    ridges = (recipe_.surface.ridge_design(),) * len(azimuths)
    grid = FieldGrid(plan.classes(), azimuths, ridges, recipe_.fields.interior)
    whole, step = made.height_map(), MAP_STEP * made.pixel_um[0]
    surface = HeightMap(np.ascontiguousarray(whole.height_um[::MAP_STEP, ::MAP_STEP]), step, step, {})
    return predict_fields(surface, grid, nominal, expected.poses, expected.convention)


def rounded(values: np.ndarray) -> list[Any]:
    """Values with six figures, for JSON."""
    return np.array([float(f"{one:.6g}") for one in values.ravel()]).reshape(values.shape).tolist()


def judged(
    row: dict[str, Any], recipe_: PlateRecipe, expected: ExpectedPlate
) -> tuple[PlateDecision, tuple[tuple[str | None, ...], tuple[int, ...]] | None]:
    """The verdict on a plate by the design; readings and overall grades that its height map predicts, or None."""
    fields = np.array(row["radiance"])
    seen = MeasuredPlate(
        fields,
        np.array(row["u_place"]),
        np.array(row["noise"]),
        (),
        Grid((0.0, 0.0), 0.01, fields.shape[1:]),
        0.0,
        row["alike"],
        readings_of(row),
    )
    decided = decide_plate(expected, seen, recipe_)
    if "map" not in row:
        return decided, None
    readings, grades = predicted_code(replace(expected, fields=np.array(row["map"])), "datamatrix")
    return decided, (readings, tuple(one[0].grade for one in grades))


def summary(rows: list[dict[str, Any]], recipe_: PlateRecipe, expected: ExpectedPlate) -> dict[str, str]:
    """Rates over the plates, each with its count."""
    counts: dict[str, list[bool]] = {}

    def count(name: str, *, holds: bool) -> None:
        counts.setdefault(name, []).append(holds)

    for row in rows:
        kind = row["kind"]
        if "invalid" in row:
            count(f"{kind}: INVALID", holds=True)
            continue
        decided, of_map_ = judged(row, recipe_, expected)
        fields = {(one.row, one.col): one for one in decided.details.fields}
        own = fields.pop(tuple(row["field"][0]), None) if row["field"] else None
        false = any(one.significant for one in fields.values())
        count(f"a good field deviates significantly (level {recipe_.decision.alpha / 2:g})", holds=false)
        if kind == "good":
            count("good: FAIL", holds=decided.verdict == "FAIL")
            count("good: INCONCLUSIVE", holds=decided.verdict == "INCONCLUSIVE")
            count("good: classes deviate significantly", holds=decided.p_value < recipe_.decision.alpha / 2)
        else:
            count(f"{kind}: found", holds=own is not None and (own.significant or own.verdict == "FAIL"))
            count(f"{kind}: named right", holds=own is not None and own.looks_like == NAMES[kind])
        if of_map_ is None:
            continue
        readings, predicted = of_map_
        code = decided.details.code
        seen = {one.stage_deg: one.measured_grade for one in code.grades if one.parameter == OVERALL}
        for number, pose in enumerate(expected.poses):
            if not code.required[number]:
                continue
            agree = readings[number] == code.readings[number]
            count("decode: picture and predicted picture agree", holds=agree)
            off = seen[pose.stage_deg] - predicted[number]
            count("overall grade: predicted within half a grade", holds=abs(off) <= 0.5)
    return {name: rate(held) for name, held in sorted(counts.items())}


def readings_of(row: dict[str, Any]) -> tuple[str | None, ...]:
    """What the code says in every pose; rows of earlier readers hold what pictures alone gave."""
    pairs = zip(row["texts"], row["radiance"], strict=True)
    return tuple(
        read_drawn(np.array(fields), "datamatrix") if text is None else text for text, fields in pairs
    )


def rate(held: list[bool]) -> str:
    """How many of how many, and the interval of the share."""
    count, total = sum(held), len(held)
    low = 0.0 if count == 0 else float(stats.beta.ppf(0.025, count, total - count + 1))
    high = 1.0 if count == total else float(stats.beta.ppf(0.975, count + 1, total - count))
    return f"{count} of {total} ({100.0 * low:.2g} to {100.0 * high:.3g} %)"


def table(found: dict[str, str], plates: int) -> str:
    """The rates as a table of Markdown."""
    rows = [f"| {name} | {value} |" for name, value in found.items()]
    return "\n".join([f"| of {plates} plates | count (95 % interval) |", "|---|---|", *rows])


def into_docs(path: Path, text: str) -> None:
    """Replace what stands between the marks of a page."""
    page = path.read_text(encoding="utf-8")
    head, _, rest = page.partition(MARKS[0])
    _, _, tail = rest.partition(MARKS[1])
    if not tail:
        raise SystemExit(f"{path}: the marks {MARKS[0]} and {MARKS[1]} are missing")
    path.write_text(f"{head}{MARKS[0]}\n{text}\n{MARKS[1]}{tail}", encoding="utf-8")


NAMES = {
    "missing": "missing",
    "direction": "wrong direction",
    "merged": "merged",
    "filled": "filled",
    "worn": "worn",
}


def main() -> None:
    """Make the plates that are missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--plates", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--kinds",
        nargs="+",
        choices=sorted(set(KINDS)),
        default=KINDS,
        help="kinds in turn; without height maps",
    )
    parser.add_argument("--summary", action="store_true", help="judge the plates there are, and print rates")
    parser.add_argument("--docs", type=Path, help="page whose table of rates is replaced, with --summary")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    path = given.folder / "plates.jsonl"
    done = len(path.read_text(encoding="utf-8").splitlines()) if path.is_file() else 0
    recipe_ = recipe(demo.ANGLES_DEG)
    expected = expected_plate(recipe_, recipe_.plan.plan(), LIGHT_DEG, cached=True)
    if given.summary:
        rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        found = summary(rows, recipe_, expected)
        for name, value in found.items():
            sys.stdout.write(f"{name}: {value}\n")
        if given.docs is not None:
            into_docs(given.docs, table(found, len(rows)))
        return
    with path.open("a", encoding="utf-8") as stream:
        for number in range(done, given.plates):
            stream.write(json.dumps(plate(number, given.seed, tuple(given.kinds), recipe_, expected)) + "\n")
            stream.flush()


if __name__ == "__main__":
    main()

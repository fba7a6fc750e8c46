"""Steps of editing: texts, values, history, and what each does to points, gaps and scale."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from anisoscope.base.errors import HeightMapError, RegistrationError, UsageError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.editing.operations import OPERATIONS
from anisoscope.profiles.editing.steps import Step, described, edit_map
from anisoscope.profiles.files.load import read_height_map, write_height_map
from anisoscope.profiles.heightmap import INTENSITY, HeightMap
from anisoscope.profiles.ideal import ridges

PIXEL = 2.0, 3.0  # x, y in µm


def plane(shape=(30, 40), gaps=0.1, seed=0):
    y, x = np.mgrid[: shape[0], : shape[1]]
    z = 0.3 * x * PIXEL[0] - 0.2 * y * PIXEL[1]
    return HeightMap(np.where(np.random.default_rng(seed).random(shape) < gaps, np.nan, z), *PIXEL)


def test_texts_mappings_and_steps_are_the_same():
    surface = plane()
    texts = ["form=poly2", "filter=gaussian,20,keep:short", 'crop=10,x1:60,y1:"70"']
    mappings = [
        {"step": "form", "form": "poly2"},
        {"step": "filter", "filter": "gaussian", "cutoff": 20.0, "keep": "short"},
        {"step": "crop", "x0": 10, "x1": 60, "y1": 70},
    ]
    found = [edit_map(surface, steps) for steps in (texts, mappings, [Step.parse(text) for text in texts])]
    for one in found:
        np.testing.assert_array_equal(one.height_um, found[0].height_um)
        assert one.origin["history"] == found[0].origin["history"]
    assert [one["step"] for one in found[0].origin["history"]] == ["form", "filter", "crop"]
    assert found[0].origin["history"][1]["values"]["direction"] == "xy"  # defaults are noted too
    assert found[0].origin["history"][2]["points"] == [24, 26]
    assert "history" not in surface.origin


@pytest.mark.parametrize(
    ("step", "message"),
    [
        ("polish", "no step 'polish'; there are level, form"),
        ("", "no step"),
        ("form", "form: form is missing"),
        ("form=cone", "form is one of"),
        ("level=auto,plane", "at most 1"),
        ("filter=gaussian,cutoff:10,cutoff:11", "given twice"),
        ("filter=gaussian,20,size:3", "no parameter 'size'"),
        ("filter=gaussian,wide", "number of µm"),
        ("filter=gaussian,inf", "number of µm"),
        ("filter=butterworth,20", "one of gaussian"),
        ("filter=spline,20,order:1", "no order"),
        ("filter=closing,20,direction:x", "no direction"),
        ("outliers=5,window:4.5", "whole number"),
        ("outliers=5,window:4", "windows of"),
        ("outliers=0", "above 0"),
        ("fill=harmonic,border:maybe", "yes or no"),
        ("mask", "either a picture"),
        ("mask=a.png,polygon:0 0;1 1;2 0", "either a picture"),
        ("mask=polygon:0 0; 5", "a polygon is x y"),
        ("mask=polygon:0 0; 5 5", "three corners"),
        ("mask=polygon:500 500; 510 500; 500 510", "no measured point is left"),
        ("mask=missing.png", "cannot be read as a picture"),
        ("crop=200", "less than two points along x"),
        ("crop=y1:-1", "less than two points along y"),
        ("rotate=45", "points would be left"),
        ("resample=0.001", "0.01 to 1000"),
        ("resample=70", "less than two points"),
        ("subtract", "map is missing"),
        ("subtract=missing.x3p", "cannot be read"),
    ],
)
def test_steps_that_cannot_be(step, message):
    surface = plane((30, 3)) if step == "rotate=45" else plane()
    with pytest.raises((UsageError, HeightMapError), match=message) as caught:
        edit_map(surface, [step])
    assert "\n" not in str(caught.value)


def test_what_is_no_map_and_no_list_is_refused():
    with pytest.raises(UsageError, match="HeightMap"):
        edit_map(np.eye(4), ["level"])
    with pytest.raises(UsageError, match="list of steps"):
        edit_map(plane(), "level")


@pytest.mark.parametrize("suffix", [".x3p", ".npz", ".gsf"])
def test_history_travels_with_the_file_and_goes_on(tmp_path, suffix):
    first = tmp_path / "measured.x3p"
    write_height_map(HeightMap(plane().height_um, *PIXEL, {"comment": "from the shop floor"}), first)
    second = tmp_path / f"edited{suffix}"
    write_height_map(edit_map(read_height_map(first), ["form=plane"]), second)
    again = edit_map(read_height_map(second), ["fill"])
    history = again.origin["history"]
    assert [one["step"] for one in history] == ["read", "form", "fill"]
    assert history[0]["values"]["file"] == "measured.x3p"
    assert history[0]["values"]["sha256"] == read_height_map(first).origin["sha256"]
    assert history[2]["found"]["points_filled"] > 50
    assert again.origin["comment"] == "from the shop floor"
    assert json.loads(json.dumps(history)) == history
    assert [described(one).partition(":")[0] for one in history] == ["read", "form", "fill"]


def test_level_of_ridges_keeps_their_slope():
    surface = ridges(RidgeDesign(100.0, 10.0), (60, 730), 1.0)
    x = np.arange(730.0)
    tilted = surface.with_height(surface.height_um + 0.01 * x)
    levelled = edit_map(tilted, ["level"])
    assert levelled.origin["history"][0]["found"]["tilt_x_deg"] == pytest.approx(0.573, abs=0.01)
    slopes = np.diff(levelled.height_um[0])
    assert np.degrees(np.arctan(np.median(slopes))) == pytest.approx(
        np.degrees(np.arctan(np.median(np.diff(surface.height_um[0])))), abs=0.01
    )
    flat = edit_map(plane(), ["level=plane"])
    assert np.nanmax(np.abs(flat.height_um)) < 1e-9


def test_crop_counts_from_the_first_point():
    surface = plane(gaps=0.0)
    cut = edit_map(surface, ["crop=10,9,20,15"])
    np.testing.assert_array_equal(cut.height_um, surface.height_um[3:6, 5:11])
    assert cut.origin["history"][0]["found"] == {
        "first_row": 3,
        "last_row": 5,
        "first_col": 5,
        "last_col": 10,
    }


def test_quarter_turns_move_points_and_swap_pixels():
    surface = plane()
    turned = edit_map(surface, ["rotate=90"])
    assert (turned.shape, turned.pixel_x_um, turned.pixel_y_um) == ((40, 30), 3.0, 2.0)
    # what points along +x points along +y afterwards
    np.testing.assert_array_equal(turned.height_um[:, -1], surface.height_um[0])
    assert edit_map(surface, ["rotate=90,field:full"]).shape == turned.shape  # the word of the version before
    back = edit_map(turned, ["rotate=270"])
    np.testing.assert_array_equal(back.height_um, surface.height_um)
    assert (back.pixel_x_um, back.pixel_y_um) == PIXEL
    twice = edit_map(surface, ["rotate=-180"])
    np.testing.assert_array_equal(twice.height_um, surface.height_um[::-1, ::-1])


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
@pytest.mark.parametrize("extent", ["inside", "full"])
def test_a_plane_turns_into_the_turned_plane(interpolation, extent):
    surface = plane((50, 60), 0.05)
    turned = edit_map(surface, [f"rotate=30,extent:{extent},interpolation:{interpolation}"])
    a = np.radians(30.0)
    rows, cols = turned.shape
    y, x = np.mgrid[:rows, :cols]
    slope_x, slope_y = 0.3 * np.cos(a) + 0.2 * np.sin(a), 0.3 * np.sin(a) - 0.2 * np.cos(a)
    expected = slope_x * (x - (cols - 1) / 2) * PIXEL[0] + slope_y * (y - (rows - 1) / 2) * PIXEL[1]
    expected += 0.3 * 59 - 0.2 * 49 * 1.5
    left = np.abs(turned.height_um - expected)
    assert np.nanmax(left) < (1e-9 if interpolation == "linear" else 0.2)
    assert np.nanmedian(left) < 1e-5
    if extent == "inside":
        assert turned.missing_share == pytest.approx(surface.missing_share, abs=0.02)
    else:
        area = turned.shape[0] * turned.shape[1] * (1.0 - turned.missing_share)
        assert area == pytest.approx(50 * 60 * (1.0 - surface.missing_share), rel=0.07)


def test_ridges_turn_counter_clockwise():
    from anisoscope.profiles.period import find_period

    surface = ridges(RidgeDesign(40.0, 10.0), (300, 300), 1.0)
    assert find_period(edit_map(surface, ["rotate=25"])).direction_deg == pytest.approx(25.0, abs=0.1)


def test_masks_by_polygon_and_picture_agree(tmp_path):
    surface = plane(gaps=0.0)
    polygon = edit_map(surface, ["mask=polygon:9 -1; 51 -1; 51 29; 9 29"])
    known = np.isfinite(polygon.height_um)
    assert known[:10, 5:26].all()
    assert np.count_nonzero(known) == 10 * 21
    Image.fromarray(np.where(known[::-1], 255, 0).astype(np.uint8)).save(tmp_path / "mask.png")
    picture = edit_map(surface, [f"mask={tmp_path / 'mask.png'}"])
    np.testing.assert_array_equal(picture.height_um, polygon.height_um)
    outside = edit_map(surface, [{"step": "mask", "picture": tmp_path / "mask.png", "keep": "outside"}])
    np.testing.assert_array_equal(np.isfinite(outside.height_um), ~known)
    assert outside.origin["history"][0]["found"]["points_taken_out"] == 210
    with pytest.raises(HeightMapError, match="does not fit"):
        edit_map(plane((30, 41)), [f"mask={tmp_path / 'mask.png'}"])


def test_outliers_go_and_walls_stay():
    surface = ridges(RidgeDesign(100.0, 10.0), (60, 400), 1.0)
    rng = np.random.default_rng(5)
    z = surface.height_um + 0.02 * rng.standard_normal(surface.shape)
    spikes = rng.integers(5, 55, 20), rng.integers(5, 395, 20)
    z[spikes] += 40.0
    z[30, 100:120] = np.nan
    found = edit_map(surface.with_height(z), ["outliers=6"])
    assert np.isnan(found.height_um[spikes]).all()
    lost = np.count_nonzero(np.isnan(found.height_um) & ~np.isnan(z))
    assert lost == found.origin["history"][0]["found"]["points_taken_out"]
    assert lost < 20 + 0.002 * z.size


def test_fill_is_harmonic_and_keeps_to_its_area():
    y, x = np.mgrid[:40, :50]
    z = (0.1 * (x * 2.0) ** 2 - 0.1 * (y * 3.0) ** 2) * 0.01  # harmonic
    gaps = z.copy()
    gaps[5:15, 10:20] = gaps[30, 30] = gaps[0, 3] = np.nan
    surface = HeightMap(gaps, *PIXEL)
    inner = edit_map(surface, ["fill"])
    assert np.isnan(inner.height_um[0, 3])
    assert np.count_nonzero(np.isnan(inner.height_um)) == 1
    known = np.isfinite(inner.height_um)
    np.testing.assert_allclose(inner.height_um[known], z[known], atol=1e-10)
    np.testing.assert_array_equal(inner.height_um[np.isfinite(gaps)], gaps[np.isfinite(gaps)])
    small = edit_map(surface, ["fill=max_area:6.1,border:yes"])
    assert np.count_nonzero(np.isnan(small.height_um)) == 100
    assert not np.isnan(edit_map(surface, ["fill=nearest,border:yes"]).height_um).any()


@pytest.mark.parametrize("pixel", [(5.0, 7.0), (4.0, 9.0), (0.7, 1.1), (5.0, 1.0), (2.0, 3.0)])
def test_resampled_planes_are_planes(pixel):
    surface = plane((30, 40), gaps=0.1 if min(pixel) >= 2.0 else 0.0)
    found = edit_map(surface, [{"step": "resample", "pixel": pixel[0], "pixel_y": pixel[1]}])
    assert (found.pixel_x_um, found.pixel_y_um) == pixel
    y0, x0 = found.origin["history"][0]["found"]["first_point_um"]
    rows, cols = found.shape
    y, x = np.mgrid[:rows, :cols]
    expected = 0.3 * (x * pixel[0] + x0) - 0.2 * (y * pixel[1] + y0)
    known = np.isfinite(found.height_um)
    assert known.mean() > 0.8
    np.testing.assert_allclose(found.height_um[known], expected[known], atol=1e-9)
    assert abs(rows * pixel[1] - 90.0) <= max(pixel[1], 3.0)
    assert abs(cols * pixel[0] - 80.0) <= max(pixel[0], 2.0)


def test_averages_over_cells_keep_the_mean_and_the_noise_law():
    z = np.random.default_rng(6).standard_normal((400, 400))
    found = edit_map(HeightMap(z, 1.0, 1.0), ["resample=4"])
    np.testing.assert_allclose(found.height_um, z.reshape(100, 4, 100, 4).mean(axis=(1, 3)), atol=1e-12)
    z[:4, :2] = np.nan
    z[:4, 4:7] = np.nan
    found = edit_map(HeightMap(z, 1.0, 1.0), ["resample=4"]).height_um
    assert found[0, 0] == pytest.approx(z[:4, 2:4].mean(), abs=0.01)
    assert np.isnan(found[0, 1])  # less than half of the cell was measured


def test_subtract_takes_files_and_maps(tmp_path):
    surface, other = plane(gaps=0.1, seed=1), plane(gaps=0.1, seed=2)
    write_height_map(other, tmp_path / "other.x3p")
    left = edit_map(surface, [f"subtract={tmp_path / 'other.x3p'}"])
    np.testing.assert_array_equal(
        np.isfinite(left.height_um), np.isfinite(surface.height_um) & np.isfinite(other.height_um)
    )
    assert np.nanmax(np.abs(left.height_um)) == 0.0
    assert left.origin["history"][0]["found"]["file"] == "other.x3p"
    with pytest.raises(HeightMapError, match="no common points"):
        edit_map(surface, [{"step": "subtract", "map": plane((30, 41))}])


def random_value(rng, one, surface):
    """A random value of a parameter, in or out of its range; None where it is left out."""
    field_y, field_x = surface.extent_um
    corners = rng.uniform(-0.2, 1.2, (rng.integers(3, 6), 2)) * (field_x, field_y)
    drawn = {
        "map": surface if rng.random() < 0.8 else plane(),
        "align": bool(rng.random() < 0.05),
        "form": str(rng.choice(["none", "plane", "poly2", "poly4", "sphere", "cylinder"])),
        "polygon": "; ".join(f"{x:.3f} {y:.3f}" for x, y in corners),
        "angle": float(rng.choice([90.0, -180.0, rng.uniform(-180, 180)])),
        "pixel": float(min(field_y, field_x) * rng.uniform(0.02, 0.6)),
        "cutoff": float(min(field_y, field_x) * rng.uniform(0.02, 0.6)),
    }
    if one.name in drawn:
        return drawn[one.name]
    optional = {
        "x0": float(rng.uniform(-0.1, 0.4) * field_x),
        "y0": float(rng.uniform(-0.1, 0.4) * field_y),
        "x1": float(rng.uniform(0.5, 1.1) * field_x),
        "y1": float(rng.uniform(0.5, 1.1) * field_y),
        "limit": float(rng.uniform(0.5, 8.0)),
        "border": bool(rng.random() < 0.5),
        "flat": bool(rng.random() < 0.5),
    }
    if one.choices:
        optional[one.name] = str(rng.choice(one.choices))
    return optional.get(one.name) if one.required or rng.random() < 0.5 else None


def random_step(rng, surface):
    """A random step with random values."""
    name = str(rng.choice(list(OPERATIONS)))
    drawn = {one.name: random_value(rng, one, surface) for one in OPERATIONS[name].parameters}
    return {"step": name, **{key: value for key, value in drawn.items() if value is not None}}


NEVER_MORE = {"level", "form", "filter", "mask", "outliers", "subtract", "crop"}
"""Steps that give no height where none was measured, point by point; crop is compared by its share."""


def tried(surface, step):
    """The edited map, or None where the step is refused in one line."""
    try:
        return edit_map(surface, [step])
    except (HeightMapError, UsageError, RegistrationError) as error:
        message = str(error)
    assert "\n" not in message, step
    return None


def check_points(step, surface, found, entry):
    """What a step may do to measured and missing points."""
    name, before, after = step["step"], np.isfinite(surface.height_um), np.isfinite(found.height_um)
    if name == "crop":
        part = entry["found"]
        rows = slice(part["first_row"], part["last_row"] + 1)
        cols = slice(part["first_col"], part["last_col"] + 1)
        np.testing.assert_array_equal(found.height_um, surface.height_um[rows, cols])
    elif name in NEVER_MORE:
        assert not (after & ~before).any(), step
        if name not in ("mask", "outliers", "subtract"):
            assert (before == after).all(), step
    elif name == "fill":
        assert not (before & ~after).any()
        assert entry["found"]["points_filled"] == np.count_nonzero(after & ~before)
        known, filled = surface.height_um[before], found.height_um[after]
        assert known.min() - 1e-9 <= filled.min() <= filled.max() <= known.max() + 1e-9  # no new extremes
    elif name == "rotate" and abs(step["angle"]) in (90.0, 180.0):
        assert np.count_nonzero(after) == np.count_nonzero(before)
    elif name == "stitch":
        assert np.count_nonzero(after) >= np.count_nonzero(before)
    elif before.all() and not (name == "rotate" and step.get("extent") == "full"):
        assert after.all(), step


def check_layers(step, surface, found, entry):
    """What a step may do to the intensities of the points: they move with them, and are between those that were."""
    name = step["step"]
    assert set(found.layers) == (set() if name == "stitch" else set(surface.layers)), step
    for kind, layer in found.layers.items():
        old = surface.layers[kind]
        if name == "crop":
            part = entry["found"]
            rows = slice(part["first_row"], part["last_row"] + 1)
            np.testing.assert_array_equal(layer, old[rows, part["first_col"] : part["last_col"] + 1])
        elif name in ("rotate", "resample"):
            seen = layer[np.isfinite(layer)]
            assert np.all((seen >= np.nanmin(old) - 1e-3) & (seen <= np.nanmax(old) + 1e-3)), step
        else:
            np.testing.assert_array_equal(layer, old)


def run_chain(seed):
    """A chain of random steps: after each one points, scale, units and missing points agree with its history."""
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(9, 22, 2))
    z = rng.standard_normal(shape).cumsum(axis=int(rng.integers(2)))
    z[rng.random(shape) < rng.choice([0.0, 0.1, 0.5])] = np.nan
    surface = HeightMap(z, *rng.uniform(0.5, 4.0, 2)) if np.isfinite(z).any() else plane()
    if rng.random() < 0.5:
        surface = replace(surface, layers={INTENSITY: rng.uniform(10.0, 200.0, surface.shape)})
    done = 0
    for _ in range(4):
        step = random_step(rng, surface)
        found = tried(surface, step)
        if found is None:
            continue
        done += 1
        entry = found.origin["history"][-1]
        assert len(found.origin["history"]) == done
        assert entry["step"] == step["step"]
        assert entry["points"] == list(found.shape)
        assert entry["pixel_um"] == [found.pixel_y_um, found.pixel_x_um]
        assert entry["missing_share"] == np.mean(np.isnan(found.height_um))
        assert np.isfinite(found.height_um).any()
        assert not np.isinf(found.height_um).any()
        json.dumps(entry, allow_nan=False)
        check_points(step, surface, found, entry)
        check_layers(step, surface, found, entry)
        surface = found
    return done


def test_a_step_that_leaves_no_measured_point_is_refused():
    z = np.full((8, 4), np.nan)
    z[1, 1], z[1, 2] = 0.0, 1.0
    with pytest.raises(HeightMapError, match="outliers: no measured point is left of 2"):
        edit_map(HeightMap(z, 0.7, 1.5), ["outliers=0.54"])


def test_random_chains_of_steps_keep_points_units_and_gaps():
    assert sum(run_chain(seed) for seed in range(100)) > 150


@pytest.mark.soak
def test_many_random_chains_of_steps():
    assert sum(run_chain(seed) for seed in range(1000, 3000)) > 3000

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.bench.bench import ReliefSample, build_surface, plastic
from anisoscope.sim.bench.benchfile import BenchFile, MaterialPart, SamplePart
from anisoscope.sim.light.geometry import directions


def build(**fields):
    return build_surface(SamplePart(**fields), np.random.default_rng(1))


@pytest.mark.parametrize(("angle", "pitch"), [(8.0, 100.0), (15.0, 80.0)])
def test_ridges_have_their_slope_and_pitch_and_lean_toward_plus_x(angle, pitch):
    surface = build(size_mm=0.8, ridge_angle_deg=angle, pitch_um=pitch, resolved_alpha=0.0).surface
    slope = np.diff(surface.height_um[0]) / surface.pixel_x_um
    assert np.median(slope) == pytest.approx(-np.tan(np.radians(angle)))
    shift = round(pitch / surface.pixel_x_um)
    np.testing.assert_allclose(surface.height_um[:, shift:], surface.height_um[:, :-shift], atol=1e-9)


def test_the_sample_is_as_large_as_it_should_be_in_whole_pitches():
    relief = build(size_mm=0.75, pitch_um=100.0)
    height = relief.surface
    assert (height.shape[1] - 1) * height.pixel_x_um == pytest.approx(700.0)
    assert (height.shape[0] - 1) * height.pixel_y_um == pytest.approx(750.0, abs=height.pixel_y_um)


def test_resolved_roughness_has_the_slope_that_was_set():
    rough, smooth = (build(size_mm=1.0, resolved_alpha=a, ridge_angle_deg=0.0).surface for a in (0.05, 0.0))
    difference = rough.height_um - smooth.height_um
    for axis, pixel in ((1, rough.pixel_x_um), (0, rough.pixel_y_um)):
        slope = np.diff(difference, axis=axis) / pixel
        assert np.sqrt(2.0) * slope.std() == pytest.approx(0.05, rel=0.05)


def test_burrs_cover_the_share_that_was_set():
    bare, spoiled = (build(size_mm=1.0, resolved_alpha=0.0, burr_coverage=c).surface for c in (0.0, 0.08))
    raised = spoiled.height_um > bare.height_um + 1e-6
    assert raised.mean() == pytest.approx(0.08, abs=0.015)
    np.testing.assert_array_equal(spoiled.height_um[~raised], bare.height_um[~raised])


def test_a_height_map_is_repeated_up_to_the_size_without_jumps_along_the_ridges(tmp_path):
    y, x = np.indices((50, 80), dtype=float)
    write_height_map(HeightMap(np.sin(x * np.pi / 8) + 0.1 * y, 2.0, 3.0), tmp_path / "map.x3p")
    surface = build(kind="height-map", file=tmp_path / "map.x3p", size_mm=0.4).surface
    assert surface.shape == (round(400 / 3) + 1, 201)
    assert np.abs(np.diff(surface.height_um, axis=0)).max() < 0.1001
    np.testing.assert_allclose(np.diff(surface.height_um[0, :80]), np.diff(surface.height_um[0, 80:160]))


def test_a_height_map_that_is_not_there_is_named(tmp_path):
    with pytest.raises(HeightMapError, match=r"none\.x3p"):
        build(kind="height-map", file=tmp_path / "none.x3p")


def test_plastic_is_the_material_of_the_file():
    material = plastic(MaterialPart(alpha_along=0.11, alpha_across=0.07, albedo=0.4, index=1.6))
    found = material.alpha_along, material.alpha_across, material.albedo, material.index
    assert found == (0.11, 0.07, 0.4, 1.6)


def shown(stage_deg, *, optics=None, **sample):
    """Radiance of smooth ridges on a bench, (rows, cols)."""
    table = {"schema": 1, "sample": {"size_mm": 0.8, "resolved_alpha": 0.0} | sample, "optics": optics or {}}
    file = BenchFile.model_validate(table)
    bare = ReliefSample(build_surface(file.sample, np.random.default_rng(1)), file)
    sides = directions((Pose(stage_deg),), Convention(10.0))
    return bare.radiance(*(side[0] for side in sides))[0]


def test_reflections_brighten_what_the_light_leaves_dark():
    once, often = (shown(180.0, reflections=on).mean(dtype=float) for on in (False, True))
    assert 1.12 < often / once < 1.3


def test_a_lobe_with_a_longer_tail_is_dimmer_in_the_middle_and_brighter_beside():
    gaussian, student = (
        [shown(angle, material={"lobe": lobe}).mean(dtype=float) for angle in (0.0, 90.0, 180.0)]
        for lobe in ("beckmann", "student")
    )
    assert student[0] < 0.9 * gaussian[0]
    assert student[1] > 1.2 * gaussian[1]
    assert student[2] > 1.1 * gaussian[2]


def test_a_near_lamp_stands_elsewhere_for_every_ridge():
    far, near = (
        shown(0.0, optics=optics).mean(axis=0, dtype=float) for optics in ({}, {"lamp_distance_mm": 20})
    )
    left, right = slice(0, 100), slice(-100, None)
    assert far[left].mean() == pytest.approx(far[right].mean(), rel=0.01)
    # 0.35 mm aside are 1° of the lamp; toward the mirror direction of the facets it is brighter
    assert near[left].mean() != pytest.approx(near[right].mean(), rel=0.1)
    assert near[len(near) // 2 - 50 : len(near) // 2 + 50].mean() == pytest.approx(far.mean(), rel=0.02)


def test_a_map_with_many_gaps_is_refused(tmp_path):
    height = np.zeros((40, 40))
    height[:, ::3] = np.nan
    write_height_map(HeightMap(height, 2.0, 2.0), tmp_path / "map.npz")
    with pytest.raises(HeightMapError, match="missing"):
        build(kind="height-map", file=tmp_path / "map.npz")

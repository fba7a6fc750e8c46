"""Closed forms of single defects."""

import numpy as np
import pytest

from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.defects import chatter, incomplete_filling, missing_ridges, pitch_error
from anisoscope.profiles.defects_contact import dust, edge_wear, scratches
from anisoscope.profiles.defects_layout import ridge_layout, ridge_numbers
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.profiles.patterns import GrooveDesign, turned_ridges, v_grooves
from anisoscope.profiles.period import find_period

DESIGN = RidgeDesign(60.0, 10.0)


def plane(shape=(200, 300), pixel=(1.0, 1.0), height=0.0):
    return HeightMap(np.full(shape, height), pixel[1], pixel[0])


@pytest.mark.parametrize(("radius", "flank"), [(5.0, 45.0), (8.0, 30.0)])
@pytest.mark.parametrize("pixel", [(0.25, 0.25), (1.0, 0.25)])
def test_a_worn_edge_is_a_circle_of_its_radius(radius, flank, pixel):
    """An edge between flanks of angle a loses r·(1/cos a − 1), over a width of 2·r·sin a."""
    design = GrooveDesign(40.0, flank)
    shape = (round(20 / pixel[0]), round(120 / pixel[1]))
    surface = v_grooves(design, shape, pixel, phase=0.5)  # a crest at x = 0
    worn = edge_wear(surface, radius)
    lost = (surface.height_um - worn.height_um)[shape[0] // 2]
    crest = round(40.0 / pixel[1])
    angle = np.radians(flank)
    assert lost[crest] == pytest.approx(radius * (1 / np.cos(angle) - 1), rel=0.02)
    x = (np.arange(lost.size) - crest) * pixel[1]
    inside = np.abs(x) < 0.9 * radius * np.sin(angle)
    circle = design.depth_um - radius / np.cos(angle) + np.sqrt(radius**2 - x[inside] ** 2)
    assert np.abs(worn.height_um[shape[0] // 2][inside] - circle).max() < 0.02 * radius
    outside = (np.abs(x) > radius * np.sin(angle) + pixel[1]) & (np.abs(x) < 20.0)
    assert np.abs(lost[outside]).max() < 1e-9  # flanks and valleys stay


def test_wear_spares_planes_and_valleys_and_repeats_to_itself():
    y, x = np.mgrid[:80, :90]
    tilted = HeightMap(0.2 * x - 0.3 * y, 1.0, 1.0)
    assert np.allclose(edge_wear(tilted, 6.0).height_um, tilted.height_um, atol=1e-9)
    surface = add_facet_roughness(ridges(DESIGN, (80, 240), 1.0), 0.1, 0.1, 4.0, np.random.default_rng(0))
    once = edge_wear(surface, 6.0)
    assert np.allclose(edge_wear(once, 6.0).height_um, once.height_um, atol=1e-9)
    assert once.height_um.sum() < surface.height_um.sum()
    assert np.array_equal(edge_wear(surface, 0.5).height_um, surface.height_um)


def test_worn_tool_is_a_part_with_rounded_valleys():
    surface = v_grooves(GrooveDesign(40.0, 45.0), (40, 480), 0.5)
    tool = surface.with_height(-surface.height_um[:, ::-1])
    part = -edge_wear(tool, 5.0).height_um[:, ::-1]
    raised = part - surface.height_um
    assert raised.min() >= 0.0
    assert raised.max() == pytest.approx(5.0 * (np.sqrt(2.0) - 1.0), rel=0.1)
    crest = surface.height_um > 15.0
    assert np.abs(raised[crest]).max() < 1e-9


@pytest.mark.parametrize("loss", [0.2, 0.6])
def test_incomplete_filling_is_the_design_with_height_loss(loss):
    surface = ridges(DESIGN, (100, 600), 1.0)
    wanted = ridges(RidgeDesign(60.0, 10.0, height_loss=loss), (100, 600), 1.0)
    found = incomplete_filling(surface, loss)
    assert np.abs(found.height_um - wanted.height_um).max() < 0.02 * DESIGN.full_height_um


def test_filling_lowers_crests_only_also_on_a_tilted_map():
    y, x = np.mgrid[:200, :600]
    tilt = 0.01 * x + 0.02 * y
    surface = ridges(DESIGN, (200, 600), 1.0)
    cut = (
        surface.height_um
        + tilt
        - incomplete_filling(surface.with_height(surface.height_um + tilt), 0.3).height_um
    )
    high = surface.height_um > 0.75 * DESIGN.full_height_um
    low = surface.height_um < 0.65 * DESIGN.full_height_um
    assert (cut[high] > 0.0).all()
    assert np.abs(cut[low]).max() < 0.02
    assert (incomplete_filling(surface, 0.0).height_um == surface.height_um).all()


def test_filling_gets_worse_away_from_the_gate():
    surface = ridges(DESIGN, (201, 600), 1.0)
    lost = (surface.height_um - incomplete_filling(surface, 0.4, gradient=1.0).height_um).max(axis=1)
    full = DESIGN.full_height_um
    assert lost[0] == pytest.approx(0.0, abs=0.01)
    assert lost[100] == pytest.approx(0.4 * full, rel=0.05)
    assert lost[200] == pytest.approx(0.8 * full, rel=0.05)


@pytest.mark.parametrize("error", [-8.0, 5.0, 10.0])
@pytest.mark.parametrize("direction", [0.0, 30.0])
def test_a_wrong_pitch_keeps_angles_and_roughness(error, direction):
    smooth = turned_ridges(DESIGN, (400, 480), 1.0, direction_deg=direction)
    found = pitch_error(smooth, error)
    period = find_period(found)
    assert period.pitch_um == pytest.approx(60.0 * (1 + 0.01 * error), rel=2e-3)
    assert period.direction_deg == pytest.approx(direction, abs=0.1)
    assert ridge_layout(found).ridge_angle_deg == pytest.approx(10.0, abs=0.2)
    rough = add_facet_roughness(smooth, 0.05, 0.05, 6.0, np.random.default_rng(0))
    kept = pitch_error(rough, error).height_um - found.height_um
    added = rough.height_um - smooth.height_um
    assert np.median(np.abs(kept - added)) < 0.15 * np.std(added)  # walls apart


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_missing_ridges_lie_at_the_foot(share):
    surface = ridges(DESIGN, (50, 1200), 1.0, phase=0.3)
    found = missing_ridges(surface, share, rng=np.random.default_rng(0))
    number = ridge_numbers(surface, ridge_layout(surface))
    tops = np.array([found.height_um[number == k].max() for k in range(1, number.max())])
    gone = tops < 0.05 * DESIGN.full_height_um
    assert gone.mean() == pytest.approx(share, abs=0.08)
    assert (tops[~gone] > 0.9 * DESIGN.full_height_um).all()
    nothing_left = missing_ridges(surface, 1.0, rng=np.random.default_rng(0))
    assert np.ptp(nothing_left.height_um) < 0.05 * DESIGN.full_height_um


@pytest.mark.parametrize("phase", [0.0, 0.3, 0.8])
def test_ridges_are_counted_from_foot_to_foot(phase):
    surface = ridges(DESIGN, (50, 600), 1.0, phase=phase)
    number = ridge_numbers(surface, ridge_layout(surface))
    borders = np.flatnonzero(np.diff(number[0]))
    assert np.abs(np.diff(borders) - 60).max() <= 1  # the foot lies between two points
    feet = np.minimum(surface.height_um[0, borders], surface.height_um[0, borders + 1])
    assert feet.max() < 0.1 * DESIGN.full_height_um


def test_chatter_is_a_wave_along_the_ridges():
    surface = ridges(DESIGN, (400, 600), 1.0)
    found = chatter(surface, 1.5, wavelength_um=40.0, rng=np.random.default_rng(0))
    wave = found.height_um - surface.height_um
    assert np.abs(wave).max() == pytest.approx(1.5, rel=0.01)
    assert np.std(wave) == pytest.approx(1.5 / np.sqrt(2.0), rel=0.01)
    power = np.abs(np.fft.rfft(wave, axis=0)) ** 2
    assert (np.argmax(power, axis=0) == 10).all()  # 400 µm hold ten waves
    number = ridge_numbers(surface, ridge_layout(surface))
    inside = wave[:, number[0] == 3]
    assert np.allclose(inside, inside[:, :1])
    beside = wave[:, number[0] == 4]
    assert not np.allclose(inside[:, 0], beside[:, 0], atol=0.1)


def test_a_scratch_has_its_depth_and_width_and_cuts_crests_only():
    flat = scratches(
        plane((400, 400), (0.5, 0.5)),
        100.0,
        depth_um=3.0,
        width_um=10.0,
        length_um=60.0,
        rng=np.random.default_rng(2),
    )
    assert -flat.height_um.min() == pytest.approx(3.0, rel=0.02)
    area = np.mean(flat.height_um < 0.0) * 0.04
    assert 0.0 < area < 4 * 10.0 * 90.0 * 1e-6
    surface = ridges(DESIGN, (400, 600), 1.0)
    cut = surface.height_um - scratches(surface, 100.0, depth_um=3.0, rng=np.random.default_rng(0)).height_um
    assert cut.min() >= 0.0
    assert cut.max() == pytest.approx(3.0, rel=0.1)
    assert not cut[surface.height_um < surface.height_um.max() - 3.5].any()


def test_a_grain_on_a_plane_is_as_high_as_its_diameter_and_round():
    surface = plane((200, 400), (0.5, 0.25), height=2.0)
    found = dust(surface, 100.0, diameter_um=20.0, rng=np.random.default_rng(0)).height_um - 2.0
    assert found.max() == pytest.approx(
        np.sort(found[found > 0.0])[0] * 2.0, rel=0.15
    )  # seen from above a ball starts at half its height
    diameter = found.max()
    area = np.count_nonzero(found > 0.0) * 0.125
    assert area == pytest.approx(np.pi / 4 * diameter**2, rel=0.05)


def test_dust_does_not_sink_in():
    surface = ridges(DESIGN, (300, 300), 1.0)
    found = dust(surface, 500.0, rng=np.random.default_rng(1))
    raised = found.height_um - surface.height_um
    assert raised.min() == 0.0
    assert raised[raised > 0.0].min() > 0.5


@pytest.mark.parametrize("direction", [0.0, 40.0])
def test_the_layout_knows_angle_and_ridges(direction):
    rough = add_facet_roughness(
        turned_ridges(DESIGN, (400, 400), 1.0, direction_deg=direction),
        0.05,
        0.08,
        6.0,
        np.random.default_rng(0),
    )
    layout = ridge_layout(rough)
    assert layout.ridge_angle_deg == pytest.approx(10.0, abs=0.4)
    assert layout.crest_um - layout.foot_um == pytest.approx(DESIGN.full_height_um, rel=0.1)
    with pytest.raises(HeightMapError, match="four ridges"):
        ridge_layout(plane())

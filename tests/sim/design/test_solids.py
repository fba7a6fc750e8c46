"""Bodies of plates, read by another program: closed, of the right volume, and the insert fits the part."""

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.plates import Plan, plate_map
from anisoscope.sim.design import solids
from anisoscope.sim.design.solids import Body, field_triangles, write_body
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.light.ridge_profile import ridge_polyline
from anisoscope.sim.pathtracer.plastic import Plastic
from anisoscope.sim.pathtracer.tracer import PathTracer

PLAN = Plan(
    ("ABC", ".DA"), {"A": 0.0, "B": -90.0, "C": 131.0, "D": -45.0}, 0.1, {"B": 5.0, "C": 16.0, "D": 1.0}
)
DESIGN = RidgeDesign(50.0, 10.0, 10.0, edge_radius_um=1.0)
BASE_UM = 40.0


def edges_twice(triangles):
    """Whether every edge inside a mesh is used once in each direction; the level border of a field aside."""
    points = np.round(triangles.reshape(-1, 3), 5)
    _, number = np.unique(points, axis=0, return_inverse=True)
    ring = number.reshape(-1, 3)
    edges = np.concatenate([ring[:, [0, 1]], ring[:, [1, 2]], ring[:, [2, 0]]])
    one_way = {tuple(edge) for edge in edges.tolist()}
    assert len(one_way) == len(edges)
    return [edge for edge in one_way if edge[::-1] not in one_way]


@pytest.mark.parametrize("side", ["part", "insert"])
def test_a_body_is_closed_and_has_the_volume_of_its_height_map(tmp_path, side):
    import pyvista

    body = Body(PLAN, DESIGN, BASE_UM)
    write_body(body, tmp_path / "body.stl", side)
    mesh = pyvista.read(tmp_path / "body.stl").clean()
    assert mesh.n_cells == body.triangle_count
    assert mesh.n_open_edges == 0
    assert mesh.is_manifold
    size = np.array(mesh.bounds).reshape(3, 2)
    np.testing.assert_allclose(size[:2], [[0.0, 0.3], [0.0, 0.2]], atol=1e-6)
    surface = plate_map(PLAN, DESIGN, 0.5, drafted=True).height_um
    highest = 1e-3 * max(float(one[..., 2].max()) for one in body.tiles.values())
    below = 1e-3 * BASE_UM + (highest if side == "insert" else 0.0)
    assert size[2] == pytest.approx([-below, highest if side == "part" else 0.0], abs=1e-6)
    sign = 1.0 if side == "part" else -1.0
    volume = 0.3 * 0.2 * below + sign * 1e-3 * surface.mean() * 0.3 * 0.2
    assert mesh.volume == pytest.approx(volume, rel=2e-4)


def test_the_insert_is_the_mirrored_negative_of_the_part(tmp_path):
    import pyvista

    body = Body(PLAN, DESIGN, BASE_UM)
    found = []
    for side in ("part", "insert"):
        write_body(body, tmp_path / f"{side}.stl", side)
        found.append(pyvista.read(tmp_path / f"{side}.stl").clean())
    rng = np.random.default_rng(1)
    for x, y in rng.uniform([0.005, 0.005], [0.295, 0.195], (40, 2)):
        above, _ = found[0].ray_trace([x, y, 1.0], [x, y, -0.01])
        mirrored, _ = found[1].ray_trace([0.3 - x, y, 1.0], [0.3 - x, y, -0.03])
        assert above[0, 2] == pytest.approx(-mirrored[0, 2], abs=2e-6)


@pytest.mark.parametrize("radius", [0.0, 2.0])
def test_fields_of_any_direction_are_closed_up_to_their_level_border(radius):
    side = 100.0
    for azimuth in (0.0, 1.5, 45.0, 90.0, 133.5, -90.0):
        for angle in (1.0, 16.0):
            design = RidgeDesign(50.0, angle, 10.0, edge_radius_um=radius)
            tile = field_triangles(ridge_polyline(design), design.draft_rad, side, azimuth)
            assert len(edges_twice(tile)) == 4
            border = tile[np.abs(tile[..., :2]).max(axis=-1) > 0.5 * side - 1e-6]
            assert np.all(border[:, 2] == 0.0)
            normal = np.cross(tile[:, 1] - tile[:, 0], tile[:, 2] - tile[:, 0])
            assert np.all(normal[:, 2] > 0.0)
            # no wall is steeper than the draft
            steepest = np.degrees(np.arctan(normal[:, 2] / np.hypot(normal[:, 0], normal[:, 1]).clip(1e-9)))
            assert steepest.min() > 10.0 - 1e-3
            assert 0.5 * normal[:, 2].sum() == pytest.approx(side**2, rel=1e-9)


def read_stl(path):
    """(T, 3, 3) corners of a binary STL."""
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    return np.frombuffer(path.read_bytes()[84:], record)["corners"].astype(np.float64)


def profile_of_stl(path, row_mm):
    """Heights in µm along x through an STL in mm, as its triangles are cut by a plane."""
    triangles = 1000.0 * read_stl(path)
    upper = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])[:, 2] > 1e-6
    points = []
    for first, second in ((0, 1), (1, 2), (2, 0)):
        start, end = triangles[upper][:, first], triangles[upper][:, second]
        crosses = (start[:, 1] - 1000.0 * row_mm) * (end[:, 1] - 1000.0 * row_mm) < 0.0
        start, end = start[crosses], end[crosses]
        share = (1000.0 * row_mm - start[:, 1]) / (end[:, 1] - start[:, 1])
        points.append(start[:, ::2] + share[:, None] * (end - start)[:, ::2])
    points = np.unique(np.round(np.concatenate(points), 4), axis=0)
    return points[:, 0], points[:, 1]


@pytest.mark.parametrize(
    ("radius", "foot", "reflections", "stages"),
    [(1.0, 0.0, 1, 4), (8.0, 0.0, 1, 4), (1.0, 4.0, 1, 4), (1.0, 4.0, 5, 2)],
)
def test_light_of_the_body_is_the_predicted_one(tmp_path, judged_figure, radius, foot, reflections, stages):
    """Within .5 %: the STL under the path tracer, which knows heights alone, and the model of the design."""
    design = RidgeDesign(50.0, 10.0, 10.0, edge_radius_um=radius, foot_radius_um=foot)
    write_body(Body(Plan(("A",), {"A": 0.0}, 0.3), design, BASE_UM), tmp_path / "part.stl", "part")
    x, z = profile_of_stl(tmp_path / "part.stl", 0.1501)
    at = np.arange(125.0, 175.0 + 0.005, 0.01)
    surface = HeightMap(np.broadcast_to(np.interp(at, x, z), (3, at.size)).copy(), 0.01, 0.01)
    tracer = PathTracer(surface, Plastic(0.08, 0.08, 0.1), pitch_um=50.0, reflections=reflections)
    sides = directions(pose_grid((180.0, 90.0, 45.0, 0.0)[:stages], (-10.0, 0.0, 10.0)), Convention())
    found = [tracer.radiance(*pose).mean(dtype=float) for pose in zip(*sides, strict=True)]
    expected = corrected.radiance(*sides, design, Material(0.08, 0.08, 0.1), bounces=reflections)
    assert found == pytest.approx(expected, rel=5e-3)
    what = (
        f"light of an exported body, crests of {radius:g} and feet of {foot:g} µm, {reflections} reflections"
    )
    off = np.abs(np.array(found) / expected - 1.0).max()
    judged_figure("Outline", what, "own path tracer on the STL", f"{off:.2%}", "0.5%")
    arcs, chords = design.profile(at - 125.0), np.interp(at - 125.0, *ridge_polyline(design), period=50.0)
    sag = np.abs((chords - arcs) * np.cos(np.arctan(np.gradient(arcs, 0.01)))).max()
    assert sag < 0.01
    what = f"chords of crests of {radius:g} and feet of {foot:g} µm"
    judged_figure("Outline", what, "arcs in closed form", f"{sag:.4f} µm", "0.01 µm")


def test_what_cannot_be_made_is_refused(tmp_path, monkeypatch):
    upright = Body(PLAN, RidgeDesign(50.0, 10.0, "vertical"), BASE_UM)
    with pytest.raises(UsageError, match="needs a draft"):
        write_body(upright, tmp_path / "x.stl", "part")
    monkeypatch.setattr(solids, "MOST_TRIANGLES", 100)
    with pytest.raises(UsageError, match="million triangles is too large"):
        write_body(Body(PLAN, DESIGN, BASE_UM), tmp_path / "x.stl", "part")
    assert not list(tmp_path.iterdir())

"""Shapes before the eye, and meshes from files."""

import numpy as np
import pytest

from anisoscope.base.errors import ModelError, UsageError
from anisoscope.sim.light.ink.shapes import sphere
from anisoscope.sim.proof.mesh import read_obj
from anisoscope.sim.proof.scene import Scene, cylinder_size, plane_size, printed, surface


def test_the_sphere_at_rest_is_that_of_the_ink_models():
    found, expected = surface(Scene("sphere"), 64, 96), sphere(64, 96)
    np.testing.assert_array_equal(found.normal, expected.normal)
    np.testing.assert_array_equal(found.tangent, expected.tangent)
    np.testing.assert_array_equal(found.uv, expected.uv)


@pytest.mark.parametrize("shape", ["sphere", "cylinder", "plane"])
@pytest.mark.parametrize(("yaw", "pitch"), [(0, 0), (35, 20), (170, -40), (-100, 5)])
def test_normals_face_the_eye_and_tangents_lie_across(shape, yaw, pitch):
    found = surface(Scene(shape, yaw, pitch, aspect=1.5), 48, 48)
    seen = np.any(found.normal != 0, axis=-1)
    assert seen.sum() > 80
    normal, tangent = found.normal[seen].astype(float), found.tangent[seen].astype(float)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.sum(normal * tangent, axis=-1), 0.0, atol=1e-6)
    assert normal[:, 2].min() > -1e-6
    uv = found.uv[seen]
    assert np.nanmin(uv, initial=0.5) >= 0.0
    assert np.nanmax(uv, initial=0.5) <= 1.0


def test_turning_moves_the_middle_of_the_print():
    for shape in ("sphere", "cylinder"):
        found = surface(Scene(shape, yaw_deg=36.0), 201, 201)
        np.testing.assert_allclose(found.uv[100, 100], [0.5 - 36 / 180, 0.5], atol=2e-3)
    tilted = surface(Scene("sphere", pitch_deg=30.0), 201, 201)  # the top comes forward
    np.testing.assert_allclose(tilted.uv[100, 100], [0.5, 0.5 + 30 / 180], atol=2e-3)
    flat = surface(Scene("plane", yaw_deg=30.0), 64, 64)
    np.testing.assert_allclose(flat.normal[32, 32], [0.5, 0.0, np.sqrt(0.75)], atol=1e-6)


def test_plane_and_cylinder_keep_the_aspect_of_the_print():
    wide, high = plane_size(1.6)
    assert wide / high == pytest.approx(1.6)
    radius, half = cylinder_size(1.6)
    assert np.pi * radius / (2 * half) == pytest.approx(1.6)
    assert np.hypot(radius, half) == pytest.approx(1.0)


def test_the_back_is_bare_paper():
    front, back = surface(Scene("plane"), 32, 32), surface(Scene("plane", yaw_deg=180.0), 32, 32)
    ones = np.ones((4, 4, 3), dtype=np.uint8)
    assert printed(front, ones).max() == 1.0
    assert printed(back, ones).max() == 0.0
    tube = surface(Scene("cylinder", pitch_deg=50.0), 128, 128)
    assert np.any(np.isnan(tube.uv[..., 0]) & (tube.normal[..., 2] > 0.0))  # its inner side is seen


def test_the_print_stands_upright():
    dots = np.zeros((2, 2, 3), dtype=np.uint8)
    dots[0, 1] = (1, 0, 0)  # upper right
    cover = printed(surface(Scene("plane"), 40, 40), dots)
    assert cover[12, 28, 0] == 1.0
    assert [cover[r, c].max() for r, c in ((12, 12), (28, 12), (28, 28))] == [0.0] * 3


def sphere_obj(path, rings=96, normals=True):
    """A sphere as a mesh whose texture is that of the analytic one's front half."""
    lines, faces = [], []
    for i in range(rings + 1):
        for j in range(rings + 1):
            theta, phi = np.pi * (i / rings - 0.5), np.pi * (j / rings - 0.5)
            x, y, z = np.cos(theta) * np.sin(phi), np.sin(theta), np.cos(theta) * np.cos(phi)
            lines.append(f"v {3 * x} {3 * y} {3 * z}\nvt {j / rings} {i / rings}\nvn {x} {y} {z}")
    for i in range(rings):
        for j in range(rings):
            corners = [i * (rings + 1) + j + 1]
            corners += [corners[0] + 1, corners[0] + rings + 2, corners[0] + rings + 1]
            faces.append("f " + " ".join(f"{k}/{k}/{k}" if normals else f"{k}" for k in corners))
    # one vertex on the far side, so that the box about the mesh is that of a whole sphere
    path.write_text("\n".join([*lines, "v 0 0 -3", *faces, ""]))
    return path


def test_a_sphere_of_triangles_is_the_sphere(tmp_path):
    mesh = read_obj(sphere_obj(tmp_path / "s.obj"))
    assert mesh.notes == ()
    np.testing.assert_allclose(np.linalg.norm(mesh.tangent, axis=-1), 1.0, atol=1e-9)
    middle = 0.5 * (mesh.position[:, 2].max() + mesh.position[:, 2].min())
    assert abs(middle) < 1e-9
    found, expected = surface(Scene("mesh", mesh=mesh), 65, 65), surface(Scene("sphere"), 65, 65)
    # scaled by its farthest corner, which is not on the sphere's equator
    scale = np.linalg.norm(mesh.position, axis=1).max() / np.ptp(mesh.position[:, 0]) * 2
    smaller = surface(Scene("sphere", fill=0.96 / scale), 65, 65)
    both = np.isfinite(found.uv[..., 0]) & (smaller.normal[..., 2] > 0.4)
    assert both.sum() > 0.5 * np.isfinite(expected.uv[..., 0]).sum()
    np.testing.assert_allclose(found.normal[both], smaller.normal[both], atol=3e-3)
    np.testing.assert_allclose(found.uv[both], smaller.uv[both], atol=3e-3)
    np.testing.assert_allclose(found.tangent[both], smaller.tangent[both], atol=2e-2)


def test_nearer_triangles_hide_farther_ones(tmp_path):
    (tmp_path / "two.obj").write_text(
        "v -1 -1 0\nv 1 -1 0\nv 0 1 0\nv -1 -1 1\nv 1 -1 1\nv 0 1 1\nvt .2 .2\nvt .8 .8\n"
        "f 4/2 5/2 6/2\nf 1/1 2/1 3/1\n"
    )
    mesh = read_obj(tmp_path / "two.obj")
    assert "averaged" in mesh.notes[0]
    for yaw, uv in ((0.0, 0.8), (180.0, np.nan)):
        found = surface(Scene("mesh", yaw_deg=yaw, mesh=mesh), 33, 33)
        np.testing.assert_allclose(found.uv[16, 16], uv, atol=1e-6)
        np.testing.assert_allclose(found.normal[16, 16], [0, 0, 1], atol=1e-6)


def test_negative_numbers_polygons_comments_and_missing_parts(tmp_path):
    (tmp_path / "q.obj").write_text(
        "# a square\no thing\nmtllib none.mtl\nv 0 0 0 1.0\nv 2 0 0\n"
        "v 2 2 0\nv 0 2 0\ns off\nf -4 -3 \\\n -2 -1 # all\n"
    )
    mesh = read_obj(tmp_path / "q.obj")
    assert mesh.triangles.shape == (2, 3)
    assert len(mesh.notes) == 2
    np.testing.assert_allclose(np.linalg.norm(mesh.position, axis=1), 1.0)
    np.testing.assert_allclose(mesh.uv, mesh.position[:, :2] / np.ptp(mesh.position[:, 0]) + 0.5)
    np.testing.assert_allclose(mesh.tangent, [[1, 0, 0]] * 4, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0\n", "line 1: 3 finite numbers"),
        ("v 0 0 x\n", "line 1: .* are not numbers"),
        ("v 0 0 nan\n", "line 1: 3 finite"),
        ("v 0 0 0\nf 1 1\n", "line 2: a face needs three"),
        ("v 0 0 0\nf 1 2 3\n", "line 2: vertex 2 does not exist; 1 are given"),
        ("v 0 0 0\nf 0 1 1\n", "vertex 0 does not exist"),
        ("v 0 0 0\nf 1/1 1/1 1/1\n", "texture point 1 does not exist"),
        ("v 0 0 0\nf a b c\n", "'a' is no corner"),
        ("v 0 0 0\nf 1 1 1\n", "lie in one point"),
        ("solid stl\n", "no faces"),
    ],
)
def test_mistakes_in_a_mesh_are_told_with_their_line(tmp_path, text, message):
    (tmp_path / "m.obj").write_text(text)
    with pytest.raises(UsageError, match=message):
        read_obj(tmp_path / "m.obj")


def test_scenes_that_cannot_be_shown(tmp_path):
    for scene, message in (
        (Scene("mesh"), "needs a mesh"),
        (Scene("cube"), "no shape is named"),
        (Scene(yaw_deg=np.nan), "finite"),
        (Scene(aspect=0.0), "aspect"),
    ):
        with pytest.raises(ModelError, match=message):
            surface(scene, 8, 8)
    with pytest.raises(UsageError, match="cannot be read"):
        read_obj(tmp_path / "none.obj")

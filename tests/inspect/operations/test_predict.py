"""One part has one prediction and one uncertainty: by options, by a recipe, and in Python."""

import json
from datetime import UTC, datetime

import numpy as np
import pytest
import tomli_w

import anisoscope.api as an
from anisoscope.base.errors import UsageError
from anisoscope.cli import run
from anisoscope.operations.predict import CACHED, Method, Task
from anisoscope.parameters.inputs import default_uncertainty
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.predicted import NEGLECTED_WAVES
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import ridges
from anisoscope.recipe.material_file import MaterialFile, write_material_file

PARTS = range(20)
MEASURED = Material(0.06, 0.1, 0.2, tail=0.7)
KINDS = ("difference", "michelson", "log_ratio")


@pytest.fixture(scope="module")
def material_file(tmp_path_factory):
    matrix = np.diag([0.01, 0.02, 0.03, 0.04]) ** 2
    matrix[0, 2] = matrix[2, 0] = 1e-4
    names = ("ln_alpha_along", "ln_alpha_across", "tail", "ln_albedo")
    content = {
        "id": "material-20261123-01234567",
        "name": "ABS",
        "taken_at": datetime(2026, 11, 23, tzinfo=UTC),
        "material": {
            name: getattr(MEASURED, name) for name in ("alpha_along", "alpha_across", "albedo", "tail")
        },
        "covariance": {"parameters": names, "matrix": matrix.tolist()},
        "validity": {"half_angle_deg": (0.0, 60.0)},
    }
    path = tmp_path_factory.mktemp("material") / "abs.toml"
    write_material_file(MaterialFile.model_validate(content), path)
    return path


class Part:
    """A random part: its design, plastic and poses, and what is stated of their uncertainty."""

    def __init__(self, number, material_file):
        rng = np.random.default_rng(number)
        self.design = {"ridge_angle_deg": float(rng.uniform(2.0, 20.0))}
        self.wall = ("perpendicular", "vertical", float(rng.uniform(0.0, 20.0)))[number % 3]
        self.radius = {1: 0.0, 2: 2.0, 6: 3.0}.get(number % 8)
        self.pitch = float(rng.uniform(60.0, 300.0))
        self.plastic = {
            "alpha_along": float(rng.uniform(0.03, 0.15)),
            "alpha_across": float(rng.uniform(0.05, 0.15)),
            "albedo": float(rng.uniform(0.02, 0.7)),
            "index": float(rng.uniform(1.45, 1.6)),
        }
        self.u_tail = None
        self.file = material_file if number % 10 == 9 else None
        if number % 5 == 1:
            self.plastic |= {"tail": 0.6}
        if number % 5 == 2:
            self.u_tail = 0.0
        if number % 5 == 3:
            self.plastic |= {"tail": 0.6}
            self.u_tail = 0.1
        if number % 10 == 5:
            self.plastic |= {"second_lobe": (0.2, 2.0)}
        self.angles = sorted({0.0, *rng.integers(20, 340, 2).astype(float).tolist()})
        self.tilts = [0.0] if number % 2 else [0.0, float(rng.uniform(2.0, 12.0))]
        self.bounces = "all" if number % 7 == 0 else 1

    def recipe(self, folder):
        plastic = {"file": str(self.file)} if self.file else dict(self.plastic)
        if self.u_tail is not None:
            plastic |= {"u_tail": self.u_tail}
        radius = {} if self.radius is None else {"edge_radius_um": self.radius}
        table = {
            "schema": 1,
            "product": "plate",
            "surface": {
                "pitch_um": self.pitch,
                "reflections": "all" if self.bounces == "all" else "direct",
                "design": {**self.design, "wall": self.wall, **radius},
            },
            "material": plastic,
            "poses": {"angles_deg": self.angles, "tilts_deg": self.tilts},
            "acquisition": {"exposure_s": 0.001},
            "region": {"size_mm": [2.0, 2.0]},
        }
        path = folder / "recipe.toml"
        path.write_text(tomli_w.dumps(table), encoding="utf-8")
        return path

    def options(self):
        words = [
            "--ridge-angle",
            self.design["ridge_angle_deg"],
            "--pitch",
            f"{self.pitch!r}um",
            "--wall",
            self.wall,
        ]
        words += [] if self.radius is None else ["--edge-radius", self.radius]
        for name, value in ({} if self.file else self.plastic).items():
            text = ",".join(map(repr, value)) if isinstance(value, tuple) else repr(value)
            words += [f"--{name.replace('_', '-')}", text]
        words += ["--material", self.file] if self.file else []
        words += [] if self.u_tail is None else ["--u-tail", self.u_tail]
        words += ["--angles", ",".join(map(repr, self.angles)), "--tilts", ",".join(map(repr, self.tilts))]
        return [str(word) for word in (*words, "--bounces", self.bounces)]

    def in_python(self):
        plastic = an.Material(**self.plastic)
        inputs = default_uncertainty(
            MEASURED if self.file else plastic, self.u_tail, calibrated=bool(self.file)
        )
        if self.radius == 0.0:
            inputs = an.InputUncertainty(**{**vars(inputs), "edge_radius_share": 0.0})
        known = self.u_tail is not None or self.radius == 0.0
        return an.predict(
            an.RidgeDesign(self.pitch, **self.design, wall=self.wall, edge_radius_um=self.radius or 0.0),
            angles_deg=self.angles,
            tilts_deg=self.tilts,
            material=self.file or plastic,
            inputs=inputs if known else None,
            method=an.PredictionMethod(bounces=self.bounces),
        )


def printed(capsys, *words):
    code = run(["predict", *words, "--json"])
    caught = capsys.readouterr()
    assert code == 0, caught.err
    found = json.loads(caught.out)
    u = [pose["u"] for pose in found["poses"]]
    radiance = [pose["radiance"] for pose in found["poses"]]
    return np.array([*radiance, *u, *(pair["u"][kind] for pair in found["contrasts"] for kind in KINDS)])


@pytest.mark.parametrize("number", PARTS)
def test_a_part_has_one_uncertainty_by_options_by_recipe_and_in_python(
    number, material_file, tmp_path, capsys
):
    part = Part(number, material_file)
    by_recipe = printed(capsys, "--recipe", str(part.recipe(tmp_path)))
    np.testing.assert_allclose(printed(capsys, *part.options()), by_recipe, rtol=1e-12)
    found = part.in_python()
    us = [np.sqrt(np.diag(found.contrast_covariance(kind))) for kind in KINDS]
    own = [*found.radiance, *found.u_radiance, *np.array(us).T.ravel()]
    np.testing.assert_allclose(own, by_recipe, rtol=1e-12)


def test_files_of_maps_and_recipes_are_predicted_in_python_as_by_the_command(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path / "cache"))
    path = tmp_path / "map.x3p"
    write_height_map(ridges(RidgeDesign(100.0, 10.0), (20, 601), (2.0, 1.0)), path)
    shown = printed(capsys, str(path), "--pitch", "100", "--angles", "0,90")
    assert len(list((tmp_path / "cache" / CACHED).iterdir())) == 1
    found = an.predict(path, pitch_um=100.0, angles_deg=(0, 90))
    np.testing.assert_array_equal(found.radiance, shown[:2])
    np.testing.assert_array_equal(found.u_radiance, shown[2:4])
    in_memory = an.predict(an.read_height_map(path), pitch_um=100.0, angles_deg=(0, 90))
    np.testing.assert_allclose(in_memory.radiance, shown[:2], rtol=1e-12)
    recipe = Part(0, None).recipe(tmp_path)
    by_command = printed(capsys, "--recipe", str(recipe), "--light-angle", "12")
    found = an.predict(str(recipe), convention=an.Convention(light_angle_deg=12.0))
    np.testing.assert_array_equal(found.radiance, by_command[: len(found.radiance)])
    with pytest.raises(UsageError, match="a recipe decides all but the light angle"):
        an.predict(recipe, material=Material())


def test_a_cached_prediction_is_that_of_its_task(tmp_path, monkeypatch):
    monkeypatch.setenv("ANISOSCOPE_CACHE", str(tmp_path))
    task = Task(RidgeDesign(100.0, 10.0), Material(), method=Method(bounces=1))
    (first,), (again,) = task.cached(), task.cached()
    np.testing.assert_array_equal(first.radiance, again.radiance)
    other = Task(RidgeDesign(100.0, 10.0), Material(tail=0.5), method=Method(bounces=1))
    assert other.key() != task.key()
    assert other.cached()[0].radiance[0] != first.radiance[0]


def test_waves_that_rays_neglect_are_in_u_and_in_one_line(capsys):
    fine = ["predict", "--pitch", "0.2um", "--ridge-angle", "10", "--bounces", "1"]
    assert run([*fine, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    bound = found["neglected_waves_per_sr"]
    assert bound == found["optics"]["stated_error_per_sr"] > 0.1
    own = next(row for row in found["budget"] if row["source"] == NEGLECTED_WAVES)
    np.testing.assert_allclose(own["u"], bound / np.sqrt(3.0))
    assert all(pose["u"] > bound / np.sqrt(3.0) for pose in found["poses"])
    assert run([*fine, "--no-uncertainty"]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if "waves matter here" in line]
    assert len(lines) == 1
    assert f"{bound:.2g} 1/sr" in lines[0]
    assert run(["predict", "--pitch", "12", "--ridge-angle", "4", "--model", "geometric", "--bounces", "1", "--json",
                "--alpha-along", "0.04", "--alpha-across", "0.04"]) == 0  # fmt: skip
    asked = json.loads(capsys.readouterr().out)
    assert "rays are asked for" in asked["optics"]["reason"]
    assert NEGLECTED_WAVES in [row["source"] for row in asked["budget"]]
    assert run(["predict", "--ridge-angle", "10", "--bounces", "1", "--json"]) == 0
    assert "neglected_waves_per_sr" not in json.loads(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--material", "FILE", "--tail", "0.5"], "--tail is in the material file"),
        (["--material", "none.toml"], "none.toml"),
        (["--material", "FILE", "--spectrum", "s.csv"], "leave --material out"),
        (["--tail", "2"], "--tail: the tail of the lobe must lie between 0 and 1.6"),
        (["--model", "printed", "--tail", "0.5"], "printed model has Beckmann's lobe"),
        (["--model", "printed", "--edge-radius", "2"], "--edge-radius needs --model corrected"),
        (["--wall", "70"], "--wall: a wall stands within"),
    ],
)
def test_what_does_not_go_together_is_one_line(words, message, material_file, capsys):
    words = [str(material_file) if word == "FILE" else word for word in words]
    assert run(["predict", "--ridge-angle", "10", *words]) in (64, 65, 78)
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1

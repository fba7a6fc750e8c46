"""JSON of the commands: what becomes of results, and that no key of it changes unseen."""

import json
import math
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path

import numpy as np
import pytest
from pydantic import BaseModel, Field

from anisoscope.base.json_fields import LEFT_OUT, as_json, in_json, json_field
from anisoscope.cli import run
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.ideal import add_facet_roughness, ridges


class Colour(StrEnum):
    RED = "red"


class Model(BaseModel):
    schema_version: int = Field(default=1, alias="schema")
    width: float | None = math.inf


@dataclass(frozen=True)
class Result:
    values: np.ndarray
    model: Model
    where: Path


def test_results_become_what_json_holds_and_what_is_not_finite_null():
    found = as_json(
        {"one": Result(np.array([[1.0, np.nan]]), Model(), Path("a/b")), "two": (Colour.RED, -math.inf)}
    )
    assert found == {
        "one": {"values": [[1.0, None]], "model": {"schema": 1, "width": None}, "where": "a/b"},
        "two": ["red", None],
    }
    plain = as_json(
        [np.float64(0.5), np.int64(3), np.bool_(True), datetime(2026, 1, 2, tzinfo=UTC), None, True, 2]
    )
    assert plain == [0.5, 3, True, "2026-01-02T00:00:00+00:00", None, True, 2]
    assert [type(one) for one in plain[:3]] == [float, int, bool]
    with pytest.raises(TypeError):
        json.dumps(as_json(object()))


@dataclass(frozen=True)
class Declared:
    picture: np.ndarray = field(metadata=LEFT_OUT)
    weight: float = field(metadata=json_field("lambda"))
    where: Path = field(metadata=json_field(by=lambda path: path.name))
    model: Model = field(metadata=json_field(by=lambda model: {"schema": model.schema_version}, merged=True))

    @property
    @in_json("sum")
    def total(self):
        return self.picture.sum()

    @property
    @in_json()
    def verdict(self):
        return "of the base"

    @property
    def internal(self):
        return 1


class Derived(Declared):
    @property
    @in_json("says")
    def verdict(self):
        return "of the class"


def test_what_differs_from_the_fields_is_declared_there():
    values = (np.array([1.0, 2.0]), 0.2, Path("a/b"), Model())
    shown = {"lambda": 0.2, "where": "b", "schema": 1, "sum": 3.0}
    assert as_json(Declared(*values)) == shown | {"verdict": "of the base"}
    assert as_json(Derived(*values)) == shown | {"says": "of the class"}


@dataclass(frozen=True)
class Partial:
    limit: float | None = field(default=None, metadata=json_field("most", only_given=True))

    @property
    @in_json(only_given=True)
    def sheet(self):
        return () if self.limit is None else (self.limit,)


def test_keys_of_what_may_be_absent():
    assert as_json(Partial()) == {}
    assert as_json(Partial(0.0)) == {"most": 0.0, "sheet": [0.0]}


def keys(value, at=""):
    """All keys of a JSON document, with those of what they hold; items of a list count as one."""
    if isinstance(value, dict):
        inner = (keys(item, f"{at}{key}.") for key, item in value.items())
        return {f"{at}{key}" for key in value}.union(*inner)
    return set().union(*(keys(item, at) for item in value)) if isinstance(value, list) else set()


@pytest.fixture(scope="module")
def ridged(tmp_path_factory):
    """A rough ridged map with a burr."""
    rng = np.random.default_rng(1)
    surface = add_facet_roughness(ridges(RidgeDesign(60.0, 10.0), (200, 500), 1.0, 0.3), 0.05, 0.08, 6.0, rng)
    y, x = np.indices(surface.shape)
    burr = 6.0 * np.maximum(0.0, 1.0 - ((x - 213) / 8) ** 2 - ((y - 100) / 12) ** 2)
    path = tmp_path_factory.mktemp("maps") / "ridged.x3p"
    write_height_map(
        surface.with_height(surface.height_um + 0.02 * rng.standard_normal(surface.shape) + burr), path
    )
    return str(path)


@pytest.fixture(scope="module")
def series(tmp_path_factory):
    """Sixty values of parts of four known sizes, the last of them shifted."""
    rng = np.random.default_rng(1)
    known = np.tile([9.0, 9.5, 10.5, 11.0], 15)
    width = known + 0.1 * rng.normal(size=60) + 2.5 * (np.arange(60) >= 30)
    path = tmp_path_factory.mktemp("series") / "series.csv"
    lines = [f"t{k},{a},{b}" for k, (a, b) in enumerate(zip(known, width, strict=True))]
    path.write_text("\n".join(["time,reference,width", *lines]) + "\n")
    return str(path)


PREDICT = """
bounces budget budget.correlation budget.kind budget.relative budget.source budget.u contrasts
contrasts.difference contrasts.from_deg contrasts.log_ratio contrasts.michelson contrasts.tilt_deg
contrasts.to_deg contrasts.u contrasts.u.difference contrasts.u.log_ratio contrasts.u.michelson convention
convention.facet_azimuth_deg convention.light_angle_deg convention.rotation_sense convention.tilt_plane
covariance covariance.difference covariance.difference.labels covariance.difference.matrix
covariance.log_ratio covariance.log_ratio.labels covariance.log_ratio.matrix covariance.michelson
covariance.michelson.labels covariance.michelson.matrix covariance.radiance covariance.radiance.labels
covariance.radiance.matrix groove_angle_deg groove_wall k model monte_carlo monte_carlo.draws
monte_carlo.mean monte_carlo.u monte_carlo.u_error_share monte_carlo.u_first_order optics optics.asked
optics.coherence_um optics.f_um optics.model optics.reason optics.stated_error optics.stated_error_per_sr
optics.wavelengths_nm poses poses.radiance poses.stage_deg poses.tilt_deg poses.u reflections_from
"""
RIDGES = """
along_variation_deg along_variation_deg.u along_variation_deg.value alpha_across alpha_across.u
alpha_across.value alpha_along alpha_along.u alpha_along.value angle_variation_deg angle_variation_deg.u
angle_variation_deg.value bandwidth_um burrs burrs.area_um2 burrs.height_um burrs.kind burrs.points
burrs.volume_um3 burrs.x_um burrs.y_um direction_deg direction_deg.u direction_deg.value edge_radius_um
edge_radius_um.at_most edge_radius_um.u edge_radius_um.value facet_bow facet_share foot_loss foot_loss.u
foot_loss.value foot_radius_um foot_radius_um.at_most foot_radius_um.u foot_radius_um.value form_um
height_loss height_loss.u height_loss.value height_step_um height_um height_um.u height_um.value
height_variation_um height_variation_um.u height_variation_um.value lay_um lean_deg line_drift_um
missing_share noise_um noise_um.u noise_um.value period_limit_um periodicity pitch_um pitch_um.u
pitch_um.value plateau remarks ridge_angle_deg ridge_angle_deg.u ridge_angle_deg.value ridges
ridges.angle_deg ridges.angle_deg.u ridges.angle_deg.value ridges.height_um ridges.height_um.u
ridges.height_um.value ridges.number ridges.points ridges.position_um ridges.shift_um ridges.shift_um.u
ridges.shift_um.value second_direction_deg seen_limit_um segments segments.angle_deg segments.angle_deg.u
segments.angle_deg.value segments.place_um shift_variation_um shift_variation_um.u
shift_variation_um.value short_share straight strip_um surface_pitch_um surface_pitch_um.u
surface_pitch_um.value tip_radius_um varies_along wall_angle_deg wall_angle_deg.at_least wall_angle_deg.u
wall_angle_deg.value
"""
TEXTURE = """
bearing bearing.smc_10_um bearing.smc_80_um bearing.smr_mean core core.sk_um core.smr1 core.smr2
core.spk_um core.svk_um core.top_um features form free heights heights.sa_um heights.sku heights.sp_um
heights.sq_um heights.ssk heights.sv_um heights.sz_um hybrid hybrid.sdq hybrid.sdr l_filter l_filter_um
missing_share s_filter s_filter_um spatial spatial.sal_um spatial.std_deg spatial.str spatial.str_is_bound ssw_um
surface sxp_um volumes volumes.vmc_um volumes.vmp_um volumes.vvc_um volumes.vvv_um
"""
OPTIMISE = """
landscape landscape.axes landscape.names landscape.scores nominal_optimum optimum optimum.evaluations
optimum.hills optimum.mean optimum.nominal_contrast optimum.parameters optimum.parameters.at_bound
optimum.parameters.flat optimum.parameters.kept optimum.parameters.name optimum.parameters.sampling_sd
optimum.parameters.scores optimum.parameters.values optimum.part optimum.part.albedo
optimum.part.alpha_across optimum.part.alpha_along optimum.part.edge_radius optimum.part.foot_radius
optimum.part.height_loss
optimum.part.index optimum.part.internal_reflection optimum.part.pitch optimum.part.ridge_angle
optimum.part.second_lobe optimum.part.tail optimum.part.wall optimum.score optimum.sd
scoring scoring.contrast scoring.convention scoring.convention.facet_azimuth_deg
scoring.convention.light_angle_deg scoring.convention.rotation_sense scoring.convention.tilt_plane
scoring.noise scoring.noise.floor scoring.noise.share scoring.over scoring.pairs_deg scoring.quantile
scoring.samples scoring.bounces scoring.score scoring.seed scoring.tilts_deg scoring.tolerances scoring.z unit
"""
SPC = """
skipped source studies studies.chart studies.capability studies.capability.confidence studies.capability.count
studies.capability.cp studies.capability.cp.high studies.capability.cp.low studies.capability.cp.value
studies.capability.cpk studies.capability.cpk.high studies.capability.cpk.low studies.capability.cpk.value
studies.capability.lower studies.capability.mean studies.capability.outside
studies.capability.outside_expected studies.capability.pp studies.capability.pp.high
studies.capability.pp.low studies.capability.pp.value studies.capability.ppk studies.capability.ppk.high
studies.capability.ppk.low studies.capability.ppk.value studies.capability.sigma_long
studies.capability.sigma_short studies.capability.upper studies.fitted studies.ewma studies.ewma.lambda
studies.ewma.width studies.ewma_outside studies.flags studies.flags.first studies.flags.labels
studies.flags.last studies.flags.rule studies.flags.seen_at studies.flags.text studies.limits
studies.limits.baseline studies.limits.center studies.limits.lower studies.limits.range_center
studies.limits.range_upper studies.limits.sigma studies.limits.upper studies.measured studies.missing
studies.name studies.normality studies.normality.adjusted studies.normality.count studies.normality.hint
studies.normality.p studies.normality.statistic studies.notes studies.stable studies.verdict
studies.wide_ranges
"""
LINEARITY = """
alpha fit intercept intercept.p intercept.t intercept.u intercept.value levels levels.alpha levels.bias
levels.count levels.high levels.low levels.mean levels.p levels.reference levels.sigma levels.significant
levels.t levels.u levels.verdict measured r2 sigma slope slope.p slope.t slope.u slope.value t_limit
verdict
"""
STABILITY = """
bias bias.alpha bias.bias bias.count bias.high bias.low bias.mean bias.p bias.reference bias.sigma
bias.significant bias.t bias.u bias.verdict chart chart.capability chart.chart chart.ewma chart.ewma.lambda
chart.ewma.width chart.ewma_outside chart.flags chart.flags.first chart.flags.labels chart.flags.last
chart.fitted chart.flags.rule chart.flags.seen_at chart.flags.text chart.limits chart.limits.baseline
chart.limits.center chart.limits.lower chart.limits.range_center chart.limits.range_upper
chart.limits.sigma chart.limits.upper chart.measured chart.missing chart.name chart.normality
chart.normality.adjusted chart.normality.count chart.normality.hint chart.normality.p
chart.normality.statistic chart.notes chart.stable chart.verdict chart.wide_ranges verdict
"""


@pytest.mark.parametrize(
    ("command", "wanted"),
    [
        (["predict", "--ridge-angle", "10", "--tilts=-10,0", "--covariance", "--monte-carlo", "60"], PREDICT),
        (["profile", "ridges", "MAP"], RIDGES),
        (["profile", "texture", "MAP"], TEXTURE),
        (["spc", "--csv", "SERIES", "--number", "width", "--lower", "5", "--upper", "15"], SPC),
        (["msa", "linearity", "--csv", "SERIES", "--number", "width"], LINEARITY),
        (["msa", "stability", "--csv", "SERIES", "--number", "width", "--reference", "10"], STABILITY),
        (["optimise", "--vary", "ridge_angle=3:20", "--jobs", "1"], OPTIMISE),
    ],
    ids=lambda one: one[1] if isinstance(one, list) else "",
)
def test_no_key_comes_or_goes(capsys, ridged, series, command, wanted):
    files = {"MAP": ridged, "SERIES": series}
    assert run([files.get(word, word) for word in command] + ["--json"]) in (0, 1)  # 1: out of control
    assert keys(json.loads(capsys.readouterr().out)) == set(wanted.split())

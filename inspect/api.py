"""The public face of anisoscope: ``import anisoscope.api as an``.

These names are what scripts and notebooks may rely on; defaults are those of the command line, lengths are in µm and
angles in degrees. **Everything else in this distribution is internal** and may change without notice, but for what a
device driver needs of `anisoscope.rig` (docs/own-driver.md) and a kind of part of `anisoscope.kinds.plugin`
(docs/own-kind.md). Every name has an example in docs/examples/api.md.

The module behind a name is imported when the name is first used.
"""

import ast
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from linecache import getlines
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

if TYPE_CHECKING:
    import numpy.typing as npt

    from anisoscope.base.errors import AnisoscopeError, UsageError
    from anisoscope.base.progress import Advance
    from anisoscope.calibration.corrections import list_calibrations
    from anisoscope.calibration.linearity import calibrate_linearity, calibrate_response
    from anisoscope.calibration.pictures import calibrate_dark, calibrate_flat, calibrate_stray
    from anisoscope.calibration.rotation import calibrate_rotation
    from anisoscope.commissioning.commissioning import Commissioned
    from anisoscope.commissioning.selftest import self_test
    from anisoscope.commissioning.selftest_record import Settings as SelfTestSettings
    from anisoscope.fit.fitting import Fit
    from anisoscope.history.adding import Added
    from anisoscope.history.comparing import compare
    from anisoscope.history.filters import Filters
    from anisoscope.history.store import History, open_history
    from anisoscope.ink.appearance import show_inks
    from anisoscope.inspection.archive import parse_rule as retention_rule
    from anisoscope.inspection.archive_store import open_store as open_archive
    from anisoscope.inspection.batch.codes import read_codes, read_picture
    from anisoscope.inspection.check_standard import run_check, teach_check
    from anisoscope.inspection.integrity import verify
    from anisoscope.inspection.recompute import recompute
    from anisoscope.inspection.reflectance_scan import begin_scan as scan
    from anisoscope.inspection.reflectance_scan import resume_scan
    from anisoscope.inspection.run import Inspected
    from anisoscope.inspection.run import resume_part as resume
    from anisoscope.kinds.recipes import read_any_recipe as read_recipe
    from anisoscope.live_view.autofocus import Autofocus
    from anisoscope.operations.archiving import archived_inspections, pull, push, retain
    from anisoscope.operations.archiving import hold as hold_archived
    from anisoscope.operations.design.etched import (
        dot_pattern,
        etch_depths,
        etched_antimirror,
        etched_lobe,
        mirror_design,
        refine_dot,
    )
    from anisoscope.operations.design.pictures import etched_hologram, etched_picture
    from anisoscope.operations.design.plates import design_code, design_plate
    from anisoscope.operations.facets import angle_map, write_angle_map
    from anisoscope.operations.fit import fit_ridges
    from anisoscope.operations.optimising import optimise
    from anisoscope.operations.past import (
        add_cycles,
        bundle,
        export_aqdef,
        export_history,
        read_cycles,
        verify_history,
        whatif,
    )
    from anisoscope.operations.predict import Method as PredictionMethod
    from anisoscope.operations.predict import predict
    from anisoscope.operations.reflectance import bsdf_textures, export_bsdf, reflectance_of
    from anisoscope.operations.remembering import lot_mates, remember
    from anisoscope.operations.render import render_frame, render_plate
    from anisoscope.operations.rigging import focus, home_axis, move_axis, rig_status, snap
    from anisoscope.operations.series import batch, watch
    from anisoscope.operations.statistics import (
        control_charts,
        msa_bias,
        msa_gauge,
        msa_linearity,
        msa_process,
        msa_stability,
        msa_type1,
    )
    from anisoscope.operations.teaching import (
        add_golden,
        certify_golden,
        check_recipe,
        remove_golden,
        suggest_poses,
        teach,
    )
    from anisoscope.parameters.fabrication import Fabrication, HologramSearch
    from anisoscope.parameters.geometry import Convention, Pose
    from anisoscope.parameters.inputs import InputUncertainty
    from anisoscope.parameters.manufacture import Manufacture
    from anisoscope.parameters.material import Material
    from anisoscope.parameters.microscope import Microscope
    from anisoscope.parameters.optics import Optics
    from anisoscope.parameters.ridges import RidgeDesign
    from anisoscope.parameters.taking import Sweep, Taking
    from anisoscope.parameters.workers import Workers
    from anisoscope.prediction.predicted import Predicted
    from anisoscope.profiles.comparison import Comparison, compare_maps
    from anisoscope.profiles.editing.steps import edit_map
    from anisoscope.profiles.files.load import read_height_map, write_height_map
    from anisoscope.profiles.heightmap import HeightMap
    from anisoscope.profiles.ideal import make_surface
    from anisoscope.profiles.lines import line_parameters
    from anisoscope.profiles.metrology.ridgemeasurement import RidgeMeasurement
    from anisoscope.profiles.metrology.ridges import measure_ridges
    from anisoscope.profiles.metrology.stepheight import step_height
    from anisoscope.profiles.textures.texture import texture
    from anisoscope.quality.attribute import attribute_study as msa_attribute
    from anisoscope.quality.attribute import read_decisions
    from anisoscope.quality.capability import Specification
    from anisoscope.quality.chart_limits import read_chart_limits, write_chart_limits
    from anisoscope.quality.control import ControlStudy
    from anisoscope.quality.drift import drift_study
    from anisoscope.quality.readings import Readings, history_readings, read_readings
    from anisoscope.record.schema import Record, read_record
    from anisoscope.rig.acquisition.nexus import write_nexus
    from anisoscope.rig.acquisition.opening import open_rig
    from anisoscope.rig.discovery import find_ports
    from anisoscope.rig.drivers import open_camera, open_light, open_stage
    from anisoscope.rig.framefolder import draft_table as draft_frame_table
    from anisoscope.rig.rigfile import read_rig
    from anisoscope.sim.design.antimirror import AntiMirror
    from anisoscope.sim.design.lobe import LobeTask, design_lobe
    from anisoscope.sim.light.colour.spaces import encode as srgb
    from anisoscope.sim.light.contrasts import contrasts
    from anisoscope.sim.light.ink.ink import Ink
    from anisoscope.sim.light.ink.model import brdf_at_angles as ink_brdf
    from anisoscope.sim.light.ink.shading import Light as InkLight
    from anisoscope.sim.light.ink.shading import picture as ink_picture
    from anisoscope.sim.light.ink.shapes import sphere
    from anisoscope.sim.materials.inks import find_ink
    from anisoscope.sim.materials.spectra import find_illuminant
    from anisoscope.sim.press import Change as MachineChange
    from anisoscope.sim.press import mould, write_moulded
    from anisoscope.study.objective import Noise, Scoring, Tolerances
    from anisoscope.study.whatif import Costs

    __version__: str
    from anisoscope.experiment.experiment import Setup as ExperimentSetup
    from anisoscope.experiment.experiment import read_measured as read_measured_contrasts
    from anisoscope.experiment.experiment import run_experiment as experiment
    from anisoscope.experiment.findings_map import findings_maps as findings_map
    from anisoscope.ink.fitting import InkFit
    from anisoscope.operations.detecting import detection_of_masters, detection_of_parts, recipe_yield
    from anisoscope.operations.inks import calibrate_ink, compare_inks, fit_ink
    from anisoscope.operations.inspecting import inspect
    from anisoscope.operations.map_series import map_values, measure_maps, write_map_table
    from anisoscope.operations.proofing import halftone, soft_proof
    from anisoscope.parameters.proof import ProofView
    from anisoscope.parameters.texture import MapUncertainty
    from anisoscope.profiles.limits import judge as judge_limits
    from anisoscope.profiles.limits import read_limits
    from anisoscope.profiles.metrology.regions import direction_regions
    from anisoscope.profiles.textures.texture import texture_uncertainty
    from anisoscope.report.experiment_page import write_experiment_page, write_findings_page
    from anisoscope.report.ink_page import write_ink_fit_page, write_ink_show_page
    from anisoscope.report.study_page import StudyPage
    from anisoscope.report.texture_picture import write_texture_picture
    from anisoscope.sim.materials.inks import read_ink_table, write_ink
    from anisoscope.sim.proof.halftone import Press
    from anisoscope.study.best_angle import best_angle
    from anisoscope.study.convergence import convergence

DriverGroup = Literal["stages", "cameras", "lights"]

__all__ = [
    "AnisoscopeError",
    "AntiMirror",
    "Autofocus",
    "ControlStudy",
    "Convention",
    "Costs",
    "ExperimentSetup",
    "Fabrication",
    "Filters",
    "Fit",
    "HeightMap",
    "History",
    "HologramSearch",
    "Ink",
    "InkFit",
    "InkLight",
    "InputUncertainty",
    "Inspected",
    "LobeTask",
    "MachineChange",
    "Manufacture",
    "MapUncertainty",
    "Material",
    "Microscope",
    "Noise",
    "Optics",
    "Pose",
    "Predicted",
    "PredictionMethod",
    "Press",
    "ProofView",
    "Readings",
    "Record",
    "RidgeDesign",
    "RidgeMeasurement",
    "Scoring",
    "SelfTestSettings",
    "Specification",
    "StudyPage",
    "Sweep",
    "Taking",
    "Tolerances",
    "UsageError",
    "Workers",
    "add_cycles",
    "add_golden",
    "add_to_history",
    "angle_map",
    "archived_inspections",
    "batch",
    "best_angle",
    "bsdf_textures",
    "bundle",
    "calibrate_dark",
    "calibrate_flat",
    "calibrate_ink",
    "calibrate_linearity",
    "calibrate_response",
    "calibrate_rotation",
    "calibrate_stray",
    "certify_golden",
    "check_recipe",
    "commission",
    "compare",
    "compare_inks",
    "compare_maps",
    "contrasts",
    "control_chart",
    "control_charts",
    "convergence",
    "design_code",
    "design_lobe",
    "design_plate",
    "detection_of_masters",
    "detection_of_parts",
    "direction_regions",
    "dot_pattern",
    "draft_frame_table",
    "drift_study",
    "drivers",
    "edit_map",
    "etch_depths",
    "etched_antimirror",
    "etched_hologram",
    "etched_lobe",
    "etched_picture",
    "experiment",
    "export_aqdef",
    "export_bsdf",
    "export_history",
    "find_illuminant",
    "find_ink",
    "find_ports",
    "findings_map",
    "fit_ink",
    "fit_ridges",
    "focus",
    "halftone",
    "history_readings",
    "hold_archived",
    "home_axis",
    "ink_brdf",
    "ink_picture",
    "inspect",
    "judge_limits",
    "line_parameters",
    "list_calibrations",
    "lot_mates",
    "make_surface",
    "map_values",
    "measure_maps",
    "measure_ridges",
    "mirror_design",
    "mould",
    "move_axis",
    "msa_attribute",
    "msa_bias",
    "msa_gauge",
    "msa_linearity",
    "msa_process",
    "msa_stability",
    "msa_type1",
    "open_archive",
    "open_camera",
    "open_history",
    "open_light",
    "open_rig",
    "open_stage",
    "optimise",
    "predict",
    "pull",
    "push",
    "read_chart_limits",
    "read_codes",
    "read_cycles",
    "read_decisions",
    "read_height_map",
    "read_ink_table",
    "read_limits",
    "read_measured_contrasts",
    "read_picture",
    "read_readings",
    "read_recipe",
    "read_record",
    "read_rig",
    "recipe_yield",
    "recompute",
    "refine_dot",
    "reflectance_of",
    "remember",
    "remove_golden",
    "render_frame",
    "render_plate",
    "resume",
    "resume_scan",
    "retain",
    "retention_rule",
    "rig_status",
    "run_check",
    "scan",
    "self_test",
    "show_inks",
    "snap",
    "soft_proof",
    "sphere",
    "spoil",
    "srgb",
    "step_height",
    "suggest_poses",
    "teach",
    "teach_check",
    "texture",
    "texture_uncertainty",
    "verify",
    "verify_history",
    "watch",
    "whatif",
    "write_angle_map",
    "write_chart_limits",
    "write_experiment_page",
    "write_findings_page",
    "write_height_map",
    "write_height_map_report",
    "write_ink",
    "write_ink_fit_page",
    "write_ink_show_page",
    "write_map_table",
    "write_moulded",
    "write_nexus",
    "write_texture_picture",
]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - type checkers read the block of imports
    if name == "__version__":
        from importlib.metadata import version

        return version("anisoscope")
    if name not in _homes():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}; it has {', '.join(__all__)}")
    module, original = _homes()[name]
    found = getattr(import_module(module), original)
    globals()[name] = found
    return found


@cache
def _homes() -> dict[str, tuple[str, str]]:
    """Public name -> its module, and its name there: what the block of imports for type checkers says."""
    tree = ast.parse("".join(getlines(__file__)))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    return {
        one.asname or one.name: (node.module or "", one.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for one in node.names
        if (one.asname or one.name) in __all__
    }


def __dir__() -> list[str]:
    return __all__


def spoil(
    surface: "HeightMap", defect: str, severity: float | None = None, *, seed: int = 0, **values: float
) -> "HeightMap":
    """The map with a defect of known extent, as ``anisoscope profile spoil`` makes it.

    Args:
        surface: the map.
        defect: "burrs", "wear", "incomplete-filling", "ridge-angle" …
        severity: share of the defect's strongest form, 0 to 1.
        seed: of everything random.
        values: settings of the defect, such as ``coverage``.

    Raises:
        HeightMapError, UsageError: no such defect, or a value outside its range.
    """
    import numpy as np

    from anisoscope.profiles.defect_injection import inject_defect

    return inject_defect(
        surface, defect, np.random.default_rng(seed), severity=severity, values=values or None
    )


def add_to_history(history: "History", folders: Sequence[Path | str]) -> "Added":
    """Add finished inspections that are not in a history yet; those that are, are passed over.

    Args:
        history: opened by `open_history`.
        folders: of inspections, or folders above them.

    Raises:
        UsageError: a folder without any inspection.
        HistoryError: the database cannot be written.
    """
    from anisoscope.history.adding import add_folders

    return add_folders(history, [Path(folder) for folder in folders])


def write_height_map_report(surface: "HeightMap | Comparison", name: str, path: Path | str) -> None:
    """Write the HTML page of a height map, or of two that were compared.

    A map's page shows how it looks, what its ridges measure and where it comes from; that of a comparison both maps,
    their difference and its uncertainty, wear, and the ridges one by one.

    Args:
        surface: the map, or what `compare_maps` gave.
        name: title of the page; of a comparison, what it calls the second map.
        path: file to write.

    Raises:
        HeightMapError: the file cannot be written.
    """
    from anisoscope.profiles.heightmap import HeightMap

    if isinstance(surface, HeightMap):
        from anisoscope.report.profile_page import write_profile_page

        write_profile_page(surface, name, Path(path))
        return
    from anisoscope.report.comparison_page import write_comparison_page

    write_comparison_page(surface, (str(surface.first.origin.get("file", "first map")), name), Path(path))


def commission(
    rig: Path | str,
    part: Path | str,
    *,
    step_deg: float = 15.0,
    tilts_deg: Sequence[float] = (-20.0, -10.0, 10.0, 20.0),
    frames: int = 2,
    settle_s: float = 0.1,
    keep_frames: Path | str | None = None,
    on_progress: "Advance | None" = None,
) -> "Commissioned":
    """Find sense, zeros, centre, pixel size and light angle of a rig from a known part: ``anisoscope rig commission``.

    Args:
        rig: rig file; it is not changed.
        part: recipe of the ridged part that lies on the stage.
        step_deg: step of the stage over one turn.
        tilts_deg: how far a tilt axis goes from its present zero.
        frames: of every pose.
        settle_s: seconds to wait after every move.
        keep_frames: empty folder that keeps the frames.
        on_progress: called with what is being done, steps done and steps in all.

    Raises:
        AnisoscopeError: rig file, recipe or hardware, or pictures that do not carry it.
    """
    from anisoscope.base.progress import silent
    from anisoscope.commissioning.commissioning import commission as find
    from anisoscope.commissioning.commissioning import part_of_recipe
    from anisoscope.commissioning.series import Series
    from anisoscope.kinds.registry import read_recipe

    recipe = read_recipe(Path(part))
    series = Series(
        recipe.acquisition.exposure_s,
        step_deg=step_deg,
        tilts_deg=tuple(tilts_deg),
        tilt_step_deg=max(step_deg, 60.0),
        frames=frames,
        dark_frames=max(frames, 4),
        settle_s=settle_s,
        light_channel=recipe.acquisition.light_channel,
    )
    return find(
        Path(rig),
        part_of_recipe(recipe, None, 0.1),
        series,
        frames=None if keep_frames is None else Path(keep_frames),
        on_progress=silent if on_progress is None else on_progress,
    )


def control_chart(
    values: "npt.ArrayLike",
    labels: Sequence[str] | None = None,
    *,
    name: str = "value",
    lower: float | None = None,
    upper: float | None = None,
    baseline: int | None = None,
) -> "ControlStudy":
    """Chart of individual values, and what the process can keep: ``anisoscope spc`` for any numbers.

    Args:
        values: (N,) in the order in which they were measured; NaN is missing.
        labels: N names of the values; counted from 1 where they are not given.
        name: of the number.
        lower: lower limit of good parts.
        upper: upper limit of good parts; without any limit no capability is computed.
        baseline: values from the start that the limits of the chart rest on; all where it is not given.

    Raises:
        UsageError: too few values.
    """
    import numpy as np

    from anisoscope.quality.capability import Specification
    from anisoscope.quality.control import Settings, control_study
    from anisoscope.quality.limits import individuals

    series = np.asarray(values, dtype=np.float64)
    specification = None if lower is None and upper is None else Specification(lower, upper)
    return control_study(name, individuals(series, labels), Settings(baseline=baseline), specification)


def drivers(group: DriverGroup) -> tuple[str, ...]:
    """Names of the installed drivers, those of other distributions included; `open_stage` and the like take them.

    Raises:
        UsageError: there is no such group.
    """
    from anisoscope.base.errors import UsageError
    from anisoscope.base.plugins import installed

    if group not in (groups := get_args(DriverGroup)):
        raise UsageError(f"no group of drivers is called {group!r}; there are {', '.join(groups)}")
    return tuple(sorted(installed(f"anisoscope.{group}")))

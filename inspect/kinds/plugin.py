"""Public names for a kind of part from another distribution: ``from anisoscope.kinds.plugin import Kind, …``.

A kind subclasses `Kind` and the optional parts that it has, and is registered under the entry point group
``anisoscope.kinds`` (docs/own-kind.md). These names are as stable as those of `anisoscope.api`: what a kind subclasses,
receives and returns, the bases of its recipe and record, the measuring steps of the kinds of this distribution, and the
errors that make a part INVALID.
"""

from anisoscope.base.cause_words import CauseWords
from anisoscope.base.errors import CalibrationError, MeasurementError, RecipeError, RigFileError, UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.base.toml_file import LocalPath, NotNegative, Part, Positive, Share
from anisoscope.decision.equipment import Equipment
from anisoscope.decision.lot_reference import LotScatter
from anisoscope.decision.reference_parts import RadianceSet, ReferenceRow, ReferenceSet
from anisoscope.imaging.deviation_map import CellMap
from anisoscope.imaging.pose_radiance import check_light, check_view, mean_of
from anisoscope.imaging.registration.placement import Grid, View, resample
from anisoscope.imaging.views import Views, most_changed
from anisoscope.kinds.command_output import CommandOutput, Table
from anisoscope.kinds.kind import (
    Decided,
    Expected,
    Explanation,
    Judgement,
    Kind,
    Measured,
    Prediction,
    Results,
    Sitting,
)
from anisoscope.kinds.parts import (
    Beginning,
    Checking,
    Redeciding,
    Reference,
    References,
    Reporting,
    Teaching,
    Tolerances,
    usable,
)
from anisoscope.kinds.recipe_check import RecipeCheck
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.new_recipe import NewRecipe
from anisoscope.recipe.base import RecipeBase
from anisoscope.recipe.teaching import Taught
from anisoscope.record.details import Details
from anisoscope.record.schema import (
    BudgetRecord,
    CauseRecord,
    ConclusionRecord,
    DiagnosisRecord,
    Record,
)
from anisoscope.record.verdict import Verdict
from anisoscope.report.inspection_page import Pictures, Sections
from anisoscope.rig.rigfile import RigFile

__all__ = [
    "Advance",
    "Beginning",
    "BudgetRecord",
    "CalibrationError",
    "CauseRecord",
    "CauseWords",
    "CellMap",
    "Checking",
    "CommandOutput",
    "ConclusionRecord",
    "Convention",
    "Decided",
    "Details",
    "DiagnosisRecord",
    "Equipment",
    "Expected",
    "Explanation",
    "Grid",
    "Judgement",
    "Kind",
    "LocalPath",
    "LotScatter",
    "Measured",
    "MeasurementError",
    "NewRecipe",
    "NotNegative",
    "Part",
    "Pictures",
    "Pose",
    "Positive",
    "Prediction",
    "RadianceSet",
    "RecipeBase",
    "RecipeCheck",
    "RecipeError",
    "Record",
    "Redeciding",
    "Reference",
    "ReferenceRow",
    "ReferenceSet",
    "References",
    "Reporting",
    "Results",
    "RigFile",
    "RigFileError",
    "Sections",
    "Share",
    "Sitting",
    "Table",
    "Taught",
    "Teaching",
    "Tolerances",
    "UsageError",
    "Verdict",
    "View",
    "Views",
    "check_light",
    "check_view",
    "mean_of",
    "most_changed",
    "resample",
    "silent",
    "usable",
]

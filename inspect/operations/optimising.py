"""The ridge design with the most contrast, nominal or under tolerances."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite

import numpy as np

from anisoscope.base.json_fields import in_json, json_field
from anisoscope.base.progress import Advance, silent
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.parameters.workers import Workers
from anisoscope.report.study_page import Chart, Curve, Map, StudyPage, Table
from anisoscope.sim.light.geometry import directions
from anisoscope.study.box import check_bounds
from anisoscope.study.objective import Part, Scoring, score
from anisoscope.study.optimum import Landscape, Optimum, Slice, optimum

LABELS = {
    "ridge_angle": "ridge angle [°]",
    "pitch": "pitch [µm]",
    "alpha_along": "alpha along [1]",
    "alpha_across": "alpha across [1]",
}
UNITS = {"ridge_angle": "°", "pitch": " µm", "alpha_along": "", "alpha_across": ""}


@dataclass(frozen=True, eq=False)
class Best:
    """Best design within bounds.

    Attributes:
        optimum: under the tolerances, or nominal where there are none.
        nominal: without tolerances, beside a robust one; None where it is the same.
        scoring: the objective.
    """

    optimum: Optimum
    nominal: Optimum | None = field(metadata=json_field("nominal_optimum"))
    scoring: Scoring

    @property
    @in_json()
    def unit(self) -> str:
        """Unit of the contrast."""
        return self.scoring.unit

    @property
    @in_json()
    def landscape(self) -> Landscape:
        """Scores of the grid that was searched."""
        return self.optimum.landscape

    def page(self) -> StudyPage:
        """Charts, tables and notes."""
        slices = (self._chart(one) for one in self.optimum.slices)
        charts: list[Chart | Map] = [*self._map(), *slices, self._drawing()]
        tables = [self._parameters(), self._designs(), self._around()]
        return StudyPage(
            "Best ridge design", self.scoring.text, charts, tables, self._notes(), self._answer()
        )

    def _answer(self) -> str:
        best = self.optimum
        found = ", ".join(
            f"{LABELS[one.name].partition(' [')[0]} {getattr(best.part, one.name):.3g}{UNITS[one.name]} "
            f"({one.kept[0]:.3g} to {one.kept[1]:.3g} keep 99 %)"
            for one in best.slices
        )
        scatter = (
            ""
            if self.nominal is None
            else f", {best.scored.mean:.3g} ± {best.scored.sd:.2g} (1 sd) over the parts"
        )
        return f"Most contrast: {found}; contrast {best.nominal.mean:.3g} {self.unit} as designed{scatter}."

    def _drawing(self) -> Chart:
        """Section of three ridges of the optimum, to scale."""
        design = self.optimum.part.design
        x = np.linspace(0.0, 3.0 * design.pitch_um, 3001)
        curve = Curve("ridges", x, design.profile(x))
        return Chart(
            "Section of the best ridges, to scale",
            "x [µm]",
            "height [µm]",
            (curve,),
            points=False,
            to_scale=True,
        )

    def _parameters(self) -> Table:
        columns = ("parameter", "optimum", "keeps 99 % of the score", "sd between samples", "remark")
        rows = tuple(self._parameter(one) for one in self.optimum.slices)
        shown = len(columns) if any(row[-1] for row in rows) else -1
        return Table("Optimum", columns[:shown], tuple(row[:shown] for row in rows))

    def _parameter(self, one: Slice) -> tuple[str, ...]:
        at = f"at the {one.at_bound} bound" if one.at_bound else ""
        return (
            LABELS[one.name],
            f"{getattr(self.optimum.part, one.name):.4g}",
            f"{one.kept[0]:.4g} … {one.kept[1]:.4g}",
            "–" if one.sampling_sd is None else f"{one.sampling_sd:.2g}",
            "flat: it hardly matters" if one.flat else at,
        )

    def _designs(self) -> Table:
        best, plain = self.optimum, self.nominal
        designs = [("optimum" if plain is None else "robust", best.part, best.scored, best.nominal)]
        if plain is not None:
            designs.append(("nominal", plain.part, score(plain.part, self.scoring), plain.nominal))
        names, unit = [one.name for one in best.slices], self.unit
        numbers = (f"contrast, nominal [{unit}]", f"mean [{unit}]", f"sd [{unit}]", "score")
        rows = tuple(
            (
                label,
                *(f"{getattr(part, name):.4g}" for name in names),
                f"{ideal.mean:.5g}",
                f"{scored.mean:.5g}",
                f"{scored.sd:.3g}",
                f"{scored.score:.5g}",
            )
            for label, part, scored, ideal in designs
        )
        return Table("What it gives", ("design", *(LABELS[name] for name in names), *numbers), rows)

    def _around(self) -> Table:
        rows = tuple(
            (LABELS[one.name], f"{value:.4g}", f"{at:.5g}" if isfinite(at) else "–")
            for one in self.optimum.slices
            for value, at in zip(one.values[::6], one.scores[::6], strict=True)
        )
        return Table("Around the optimum", ("parameter, others held", "value", "score"), rows)

    def _notes(self) -> list[str]:
        bounces, best = self.scoring.bounces, self.optimum
        light = {1: "direct light; reflections between facet and wall are left out", "all": "all reflections"}
        found = [f"Model: corrected, {light.get(bounces, f'up to {bounces} reflections')}."]
        if best.scored.score <= 0.0:
            found.append(
                "The score is not positive: the tolerances exceed the contrast everywhere within these bounds."
            )
        if len(best.hills) > 1:
            heights = ", ".join(f"{value:.4g}" for value in best.hills)
            found.append(f"Hills climbed: {len(best.hills)}; scores at their tops: {heights}.")
        if any(one.name == "pitch" for one in best.slices):
            found.append(
                "The pitch enters through the edge radius alone: light knows angles only. Wall width, roughness and "
                "camera pixels beside the pitch, and what the eye resolves, are not part of the score."
            )
        return found

    @property
    def _score_label(self) -> str:
        return f"score [{'1' if self.scoring.score == 'snr' else self.unit}]"

    def _map(self) -> list[Map]:
        shape = self.landscape
        if len(shape.names) < 2:
            return []
        rest = tuple(range(2, len(shape.names)))
        filled = np.where(np.isfinite(shape.scores), shape.scores, np.nanmin(shape.scores))
        x, y = shape.names[:2]
        return [
            Map(
                "Score" + (", best over the other parameters" if rest else ""),
                LABELS[x],
                LABELS[y],
                self._score_label,
                shape.axes[0],
                shape.axes[1],
                filled.max(axis=rest).T,
                (getattr(self.optimum.part, x), getattr(self.optimum.part, y)),
                x != "ridge_angle",
                y != "ridge_angle",
            )
        ]

    def _chart(self, one: Slice) -> Chart:
        alone = len(self.landscape.names) == 1
        values = self.landscape.axes[0] if alone else np.array(one.values)
        scores = self.landscape.scores if alone else np.array(one.scores)
        finite = np.isfinite(scores)
        title = f"Score by {one.name.replace('_', ' ')}" + ("" if alone else ", others at the optimum")
        curve = Curve(one.name, values[finite], scores[finite])
        mark = getattr(self.optimum.part, one.name)
        return Chart(title, LABELS[one.name], self._score_label, (curve,), mark_x=mark, points=False)


def optimise(
    vary: Mapping[str, tuple[float, float]],
    *,
    design: RidgeDesign | None = None,
    material: Material | None = None,
    scoring: Scoring | None = None,
    workers: Workers | None = None,
    on_progress: Advance = silent,
) -> Best:
    """Search a box of design parameters for the most contrast.

    Args:
        vary: parameter -> its bounds; ridge_angle in degrees, pitch in µm, alpha_along, alpha_across.
        design: the other parameters of the ridges; 100 µm and 10° by default.
        material: the plastic.
        scoring: contrast, poses, tolerances; by default the difference between 0° and 90°, all reflections.
        workers: processes; one by default.
        on_progress: called with the work being done, steps done and steps in all.

    Raises:
        UsageError: unknown parameters, empty bounds, or a pitch that has no effect.
        ModelError: a pose below the horizon, or plastic outside the model's range.
        HeightMapError: ridges that are none.
    """
    asked, used = Scoring() if scoring is None else scoring, Workers(1) if workers is None else workers
    part = Part.of(design or RidgeDesign(100.0, 10.0), material or Material())
    directions(asked.poses, asked.convention)
    check_bounds(vary, part, asked)
    best, plain = optimum(part, vary, asked, used, on_progress), None
    if asked.tolerances is not None and ("pitch" not in vary or part.edge_radius > 0.0):
        plain = optimum(part, vary, asked.nominal, used, on_progress)
    return Best(best, plain, asked)

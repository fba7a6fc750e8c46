"""Files of a plate from which its mould insert is made: height maps, bodies, and cuts of part and insert."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Group, Parameter

from anisoscope.base.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.parameters.ridges import RidgeDesign
    from anisoscope.profiles.plates import Plan

MOST_POINTS = 60_000_000
"""Points of a height map: half a gigabyte."""
MOST_ANGLES = 3
MOULD = Group("Mould and tool", sort_key=20)


@Parameter(name="*", group=MOULD)
@dataclass(frozen=True, kw_only=True)
class Manufacture:
    """What is written for the making of the insert."""

    stl: Annotated[
        bool, Parameter(negative="", help="Write part and insert as closed STL bodies in mm, too.")
    ] = False
    base_mm: Annotated[float, Parameter(help="Thickness of these bodies below their surface in mm.")] = 1.0
    npz: Annotated[bool, Parameter(negative="", help="Write the height maps as npz, too.")] = False
    path: Annotated[
        bool,
        Parameter(negative="", help="Write the finishing cuts of the insert: two tables in mm, and G-code."),
    ] = False
    tool_half_angle: Annotated[
        float, Parameter(help="Half angle of the engraving cone in degrees, at most the draft.")
    ] = 10.0
    feed: Annotated[float, Parameter(help="Feed of a cut in mm/min.")] = 100.0

    def names(self) -> list[str]:
        """Files that are written."""
        found = ["part.x3p", "insert.x3p"]
        found += ["part.npz", "insert.npz"] if self.npz else []
        found += ["part.stl", "insert.stl"] if self.stl else []
        return found + (["insert-passes.csv", "insert-fields.csv", "insert.nc"] if self.path else [])

    def check(self, plan: "Plan", design: "RidgeDesign", pixel_um: float) -> None:
        """Check that all can be made, before anything is written.

        Raises:
            UsageError: a map that is too large, a base without thickness, or a tool that does not cut the ridges.
            HeightMapError: fields that are no whole number of pixels.
        """
        from anisoscope.sim.design.plates import check_mould
        from anisoscope.sim.design.toolpath import Tool

        points = plan.shape[0] * plan.shape[1] * plan.points(pixel_um) ** 2
        if points > MOST_POINTS:
            raise UsageError(
                f"a map of {points / 1e6:.0f} million points is too large (at most {MOST_POINTS / 1e6:.0f}): take "
                "fewer fields, or a larger --pixel"
            )
        if self.stl and not self.base_mm > 0.0:
            raise UsageError(f"--base-mm must be a positive number of mm, not {self.base_mm:g}")
        if self.path and not self.feed > 0.0:
            raise UsageError(f"--feed must be a positive number of mm/min, not {self.feed:g}")
        tool = Tool(design.edge_radius_um, self.tool_half_angle, self.feed) if self.path else None
        for letter in plan.letters:
            check_mould(plan.design_of(letter, design), tool)

    def write(self, out: Path, plan: "Plan", design: "RidgeDesign", pixel_um: float) -> float | None:
        """Write the files of `names` into a folder, after `check`.

        Returns:
            Length of the cuts in m; None without a path.
        """
        from anisoscope.profiles.comparison import turned_over
        from anisoscope.profiles.files.load import write_height_map
        from anisoscope.profiles.plates import plate_map
        from anisoscope.sim.design.solids import Body, write_body
        from anisoscope.sim.design.toolpath import Tool, insert_path, write_gcode, write_passes

        surface = plate_map(plan, design, pixel_um, drafted=True)
        for side in ("part", "insert"):
            if side == "insert":
                surface = turned_over(surface)
            for suffix in (".x3p", ".npz") if self.npz else (".x3p",):
                write_height_map(surface, out / f"{side}{suffix}")
        del surface
        body = Body(plan, design, 1000.0 * self.base_mm)
        if self.stl:
            write_body(body, out / "part.stl", "part")
            write_body(body, out / "insert.stl", "insert")
        if not self.path:
            return None
        cuts = insert_path(body, Tool(design.edge_radius_um, self.tool_half_angle, self.feed))
        write_passes(cuts, out / "insert-passes.csv", out / "insert-fields.csv")
        write_gcode(cuts, out / "insert.nc")
        return cuts.length_m


def new_folder(out: Path, names: list[str], *, overwrite: bool) -> None:
    """Make the folder of a design.

    Raises:
        UsageError: files exist, or the folder cannot be made.
    """
    existing = [name for name in names if (out / name).exists()]
    if existing and not overwrite:
        raise UsageError(f"{out / existing[0]} exists; give another folder, or --overwrite")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise UsageError(f"cannot make the folder {out}: {problem.strerror}") from None


def recipe_of(plan: "Plan", design: "RidgeDesign", product: str) -> dict[str, object]:
    """Tables of a recipe with its plan in ``plan.csv``; plastic, exposure and tolerances are to be adapted."""
    angle = design.ridge_angle_deg
    ridges: dict[str, object] = {"ridge_angle_deg": angle, "u_ridge_angle_deg": 0.1}
    if not isinstance(design.wall, str):
        ridges["wall"] = design.wall
    if design.edge_radius_um > 0.0:
        ridges["edge_radius_um"] = design.edge_radius_um
    fields: dict[str, object] = {
        "file": "plan.csv",
        "module_mm": plan.module_mm,
        "facet_azimuths_deg": dict(plan.azimuths_deg),
    }
    if plan.ridge_angles_deg:
        fields["ridge_angles_deg"] = dict(plan.ridge_angles_deg)
    return {
        "schema": 1,
        "kind": "plates",
        "product": product,
        "surface": {"pitch_um": design.pitch_um, "design": ridges},
        "material": {"alpha_along": 0.06, "alpha_across": 0.10, "albedo": 0.2},
        "plan": fields,
        "poses": {"angles_deg": inspected_at((0.0, 90.0))},
        "acquisition": {"exposure_s": 0.006},
        "region": {"size_mm": [round(one, 6) for one in plan.size_mm]},
        "decision": {"tolerance": 0.4},
    }


def inspected_at(stages_deg: tuple[float, ...]) -> list[float]:
    """Stage angles of an inspection: those at which a plate is looked at, and others until there are three.

    Worn and filled ridges shine after half a turn, where good ones face away.
    """
    others = [stages_deg[0] + turn for turn in (180.0, 90.0)]
    others = [one for one in others if all((one - seen) % 360.0 for seen in stages_deg)]
    return [*stages_deg, *sorted(others[: MOST_ANGLES - len(stages_deg)])]


def recipe_text(tables: dict[str, object]) -> str:
    """Text of a recipe to begin with."""
    import tomli_w

    head = (
        "# Recipe of a plate of ridges. To be adapted: [material] (its lobe is unmeasured here),\n"
        "# [acquisition], [decision] and [fields]; `anisoscope recipe check` reads it.\n"
    )
    return head + tomli_w.dumps(tables)


def plan_text(plan: "Plan") -> str:
    """Text of ``plan.csv``: a line a row of fields, the first one at the top."""
    return "".join(f"{','.join(row)}\n" for row in plan.rows)

"""Output of ``anisoscope design``."""

from typing import TYPE_CHECKING, Any

from anisoscope.base.errors import UsageError

if TYPE_CHECKING:
    from anisoscope.sim.design.designfile import DesignFile

UNITS = {
    "sigma_x": ("σ_h along x", "1"),
    "sigma_y": ("σ_h along y", "1"),
    "rel_l2": ("missed, relative L2, both axes", "1"),
    "rel_l2_x": ("missed along x", "1"),
    "rel_l2_y": ("missed along y", "1"),
    "one_width_x": ("missed with one width along x", "1"),
    "one_width_y": ("missed with one width along y", "1"),
    "intrinsic_x": ("missed with steps of any width, along x", "1"),
    "intrinsic_y": ("missed with steps of any width, along y", "1"),
    "unreachable_x": ("wanted light that stays out of reach, along x", "1"),
    "unreachable_y": ("wanted light that stays out of reach, along y", "1"),
    "hole_x": ("width of the hole along h_x", "1"),
    "hole_y": ("width of the hole along h_y", "1"),
    "ring_x": ("end of the ring at h_x", "1"),
    "ring_y": ("end of the ring at h_y", "1"),
    "hole_floor": ("floor of the hole over the ring, from the source", "1"),
}
"""What the figures of a design file mean, and their units."""


def check_seed(seed: int) -> None:
    """Refuse a seed that is none.

    Raises:
        UsageError: below 0.
    """
    if seed < 0:
        raise UsageError(f"--seed must be 0 or a positive whole number, not {seed}")


def design_json(design: "DesignFile") -> dict[str, Any]:
    """A design and its figures."""
    model = design.model.model_dump(mode="json")
    found: dict[str, Any] = {
        "name": design.name,
        "model": model,
        "depths_nm": list(design.passes_nm),
        "epsilon": design.depths.epsilon if design.passes_nm else None,
        "wavelength_nm": design.wavelength_nm,
        "band_nm": list(design.band_nm),
        "coherence_um": design.coherence_um,
        "min_width_um": design.min_width_um,
        "grid_um": design.grid_um,
        **design.figures,
    }
    if model["kind"] == "lobe":
        pairs = {
            axis: [list(pair) for pair in zip(model[f"widths_{axis}_um"], model[f"p_a_{axis}"], strict=True)]
            for axis in ("x", "y")
        }
        found["p_a"] = pairs
        found["unreachable"] = {axis: design.figures.get(f"unreachable_{axis}") for axis in ("x", "y")}
    return found


def figure_rows(design: "DesignFile") -> list[tuple[str, str, str]]:
    """(quantity, value, unit) of a design."""
    rows = [
        (UNITS[key][0], f"{value:.4g}", UNITS[key][1])
        for key, value in design.figures.items()
        if key in UNITS
    ]
    if design.passes_nm:
        rows.append(("etch passes", ", ".join(f"{depth:.1f}" for depth in design.passes_nm), "nm"))
        low, high = design.band_nm
        span = f"at {low:g} nm" if low == high else f"from {low:g} to {high:g} nm"
        rows.append((f"largest mean phase |τ| {span}", f"{design.depths.epsilon:.4f}", "1"))
    rows += [
        ("design wavelength", f"{design.wavelength_nm:g}", "nm"),
        ("coherence length", f"{design.coherence_um:g}", "µm"),
        ("smallest feature", f"{design.min_width_um:g}", "µm"),
    ]
    return rows


def width_rows(design: "DesignFile") -> list[list[str]]:
    """Widths of the steps of a lobe and how often each is drawn."""
    from anisoscope.sim.design.models import LobeModel

    if not isinstance(design.model, LobeModel):
        return []
    model = design.model
    rows = [["x", f"{a:g}", f"{p:.4f}"] for a, p in zip(model.widths_x_um, model.p_a_x, strict=True)]
    return rows + [["y", f"{a:g}", f"{p:.4f}"] for a, p in zip(model.widths_y_um, model.p_a_y, strict=True)]

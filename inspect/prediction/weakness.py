"""What a prediction leaves out, as bounds that stand beside it."""

from typing import Any

import numpy as np
import numpy.typing as npt

from anisoscope.profiles.ideal import RidgeDesign
from anisoscope.sim.light.material import Material, lobe_albedo

FloatArray = npt.NDArray[np.float64]

WORTH_SAYING = 0.005
COARSE_PATHS = 2048
_PERFECT = 1e9  # an index that mirrors everything


def lost_in_roughness(material: Material, steepest_deg: float) -> float:
    """Largest share of the light of a lobe that single scattering leaves out, at facets lit up to ``steepest_deg``.

    A microfacet lobe follows light to its first microfacet only; what meets a second one is lost to it. The loss is
    what a perfect mirror of this roughness would lack (Heitz 2014, section 5.4: the white furnace).
    """
    steepest = np.cos(np.radians(min(steepest_deg, 89.0)))
    roughness = max(material.alpha_along, material.alpha_across)
    kept = lobe_albedo(np.array([1.0, steepest]), roughness, _PERFECT)
    return float(np.max(1.0 - kept))


def roughness_note(material: Material, steepest_deg: float) -> dict[str, Any]:
    """The note on single scattering, where it is worth saying."""
    lost = lost_in_roughness(material, steepest_deg)
    return {"lost_in_roughness": lost} if lost > WORTH_SAYING else {}


def reflections_note(direct: FloatArray, twice: FloatArray) -> dict[str, Any]:
    """The note on reflections that are not followed: the largest share that a second one would add.

    Args:
        direct: (P,) direct light in 1/sr.
        twice: (P,) light that reflects exactly twice.
    """
    lit = direct > 0.0
    share = float(np.max(twice[lit] / direct[lit], initial=0.0))
    return {"second_reflection_would_add": share} if share > WORTH_SAYING else {}


def design_notes(
    to_light: FloatArray,
    to_camera: FloatArray,
    design: RidgeDesign,
    material: Material,
    direct: FloatArray,
    bounces: int | None,
) -> dict[str, Any]:
    """What direct light on ideal ridges leaves out; (P, 3) directions, (P,) radiances in 1/sr."""
    steepest = float(np.degrees(np.arccos(np.min(to_light[:, 2])))) + design.ridge_angle_deg
    notes = roughness_note(material, steepest)
    if bounces == 1:
        from anisoscope.sim.light.bounces import interreflection  # noqa: PLC0415 - numba when first needed

        notes |= reflections_note(direct, interreflection(to_light, to_camera, design, material, 2))
    return notes

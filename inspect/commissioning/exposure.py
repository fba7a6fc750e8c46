"""Check that automatic exposure is off, for cameras that have it, with any part on the stage."""

from anisoscope.rig.acquisition.opening import Rig
from anisoscope.rig.cameras.proof import ExposureProof, prove_exposure

HALF = 0.5


def proof_on(
    rig: Rig, exposure_s: float, gain: float, dark_counts: float | None = None
) -> ExposureProof | None:
    """Compare an exposure with half of it, the light on; None for a camera without automatic exposure.

    Args:
        rig: an opened rig whose stage stands still; the light is left on.
        exposure_s: exposure in seconds, at which hardly a pixel is clipped.
        gain: gain as a factor.
        dark_counts: mean counts with the light off; the black level if not given.

    Raises:
        CameraError: brightness does not follow the exposure, or nothing can be said.
    """
    if not rig.camera.info.auto_exposure:
        return None
    rig.light.on()
    return prove_exposure(rig.camera, (exposure_s, HALF * exposure_s), gain=gain, dark_counts=dark_counts)


def sentence(proof: ExposureProof) -> str:
    """The measured exponents in words."""
    return (
        f"automatic exposure is off: from {proof.exposures_s[1]:g} s to {proof.exposures_s[0]:g} s brightness grew as "
        f"the exposure to the power {proof.exponents[0]:.3f} (1 for a linear camera), and came back"
    )

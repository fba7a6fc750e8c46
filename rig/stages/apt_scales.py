"""How Thorlabs APT controllers count: steps and speeds, by model and actuator.

A stepper counts microsteps; a servo counts what the encoder of its actuator counts. Velocities come in counts per
period of the controller's clock, times 65536. Source: Thorlabs APT communications protocol, conversion tables.
"""

from dataclasses import dataclass

from anisoscope.base.errors import RigError

# One count per second in the units of velocity parameters.
STEPPER_VELOCITY = 53.68
SERVO_VELOCITY = 2048.0 / 6e6 * 65536.0
SERVOS = frozenset({"KDC101", "TDC001", "KBD101", "TBD001"})
# Rotation stages that are one with their controller.
MODELS = {"K10CR1": 409600.0 / 3.0}
ACTUATORS = {
    **dict.fromkeys(("PRM1-Z8", "PRM1/MZ8", "PRMTZ8", "PRMTZ8/M"), 1919.6418578623391),
}


@dataclass(frozen=True)
class Scale:
    """Counts per degree, velocity units per degree per second, and whether the controller drives a servo."""

    counts_per_deg: float
    velocity_per_deg_s: float
    servo: bool


def scale_of(model: str, actuator: str | None, counts_per_deg: float | None) -> Scale:
    """The scale of a controller.

    Args:
        model: what the controller calls itself.
        actuator: name of the motor that it drives, where it may drive several.
        counts_per_deg: scale from the rig file; it goes before everything else.

    Raises:
        RigError: neither model nor options tell the scale.
    """
    servo = model in SERVOS
    if counts_per_deg is None:
        counts_per_deg = MODELS.get(model) if actuator is None else _of_actuator(actuator)
    if counts_per_deg is None:
        known = " or ".join(f"actuator = '{name}'" for name in list(ACTUATORS)[:1])
        hint = f"{known}, or " if servo else ""
        raise RigError(
            f"a {model} does not tell how many counts make a degree; set the option {hint}counts_per_deg"
        )
    if counts_per_deg <= 0.0:
        raise RigError(f"counts_per_deg must be above 0, not {counts_per_deg:g}")
    per_count = SERVO_VELOCITY if servo else STEPPER_VELOCITY
    return Scale(counts_per_deg, per_count * counts_per_deg, servo)


def _of_actuator(actuator: str) -> float:
    if actuator not in ACTUATORS:
        raise RigError(
            f"actuator '{actuator}' is not known; known: {', '.join(ACTUATORS)}; or set the option counts_per_deg"
        )
    return ACTUATORS[actuator]

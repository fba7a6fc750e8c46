"""``anisoscope optimise``: the ridge design with the most contrast, nominal or under tolerances."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.help_page import MORE
from anisoscope.cli.options import (
    DRAWN,
    NO_BASE,
    OF_LIGHT,
    OF_PLASTIC,
    OF_RIDGES,
    OF_WORKERS,
    Base,
    DrawnOutput,
    Flag,
    named_numbers,
    one_number,
    pairs_of,
)
from anisoscope.cli.progress import progress
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.goal import Goal
from anisoscope.parameters.material import Material
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.parameters.workers import Workers
from anisoscope.views.options import Given, Options, parse_numbers, with_options

if TYPE_CHECKING:
    from anisoscope.study.objective import Noise, Scoring, Tolerances

TOLERANCES = "ridge_angle=0.3,alpha=0.1,height_loss=0.03,seating=0.3,stage=0.2"


@Parameter(name="*")
@dataclass(frozen=True)
class Sought:
    """What is varied, and what is scored.

    Attributes:
        vary: NAME=FROM:TO,…; names: ridge_angle, pitch, alpha_along, alpha_across.
        pair: Two stage angles, 0,90 where left out; may be given more than once.
        robust: Maximise under tolerances.
        noise: Noise of a measured radiance: floor=1/sr,share=of it (floor=1e-4,share=.005).
    """

    vary: str = "ridge_angle=3:20"
    pair: list[str] | None = None
    robust: Flag = False
    scatter: Annotated[
        str | None,
        Parameter(
            help="Standard deviations NAME=SD,…: ridge_angle [°], alpha [share], height_loss [share], edge_radius "
            f"[µm], seating [°], stage [°], light [°]. With --robust alone: {TOLERANCES}."
        ),
    ] = None
    noise: Annotated[str | None, Parameter(group=MORE)] = None

    def scoring(self, goal: Goal, convention: Convention) -> "Scoring":
        """The objective.

        Raises:
            UsageError: tolerances without --robust, or a text that is none of them.
        """
        from anisoscope.study.objective import Scoring

        if not self.robust and (self.scatter is not None or goal.quantile is not None):
            raise UsageError("--scatter and --quantile belong to --robust")
        return Scoring(
            **vars(goal),
            pairs_deg=tuple(_pair(text) for text in self.pair or ["0,90"]),
            convention=convention,
            noise=_noise(self.noise),
            tolerances=_tolerances(self.scatter or TOLERANCES) if self.robust else None,
        )


CONTRAST = Sought()
OF_GOAL = Options(
    Goal,
    groups=dict.fromkeys(("over", "score", "z", "quantile", "samples", "seed", "bounces"), MORE),
    whole=True,
)


@with_options(
    goal=OF_GOAL,
    ridges=OF_RIDGES,
    plastic=OF_PLASTIC,
    rig=OF_LIGHT,
    workers=replace(
        OF_WORKERS,
        default=Workers(),
        help={"jobs": "Processes on this machine; several help with many poses or samples."},
    ),
)
def optimise(
    *,
    base: Base = NO_BASE,
    sought: Sought = CONTRAST,
    goal: Given[Goal],
    ridges: Given[RidgeDesign],
    plastic: Given[Material],
    rig: Given[Convention],
    workers: Given[Workers],
    output: DrawnOutput = DRAWN,
) -> int:
    """Find the ridge design with the most contrast, nominal or under tolerances.

    The box of --vary is searched on a grid, then refined at the highest maxima. --bounces adds light that ridges
    reflect onto each other. The pitch matters only if something has an absolute size (--edge-radius, or a tolerance of
    it).

    Examples:
        anisoscope optimise --vary ridge_angle=3:20
        anisoscope optimise --vary ridge_angle=3:20 --robust --scatter ridge_angle=0.3,stage=0.2
        anisoscope optimise --vary ridge_angle=3:20,alpha_across=.05:.2 --plot landscape.png
    """
    from anisoscope.operations.optimising import optimise as search

    output.check()
    known = base.stated()
    design = ridges.over(known.design or RidgeDesign(known.pitch_um or 100.0, 10.0))
    scoring = sought.scoring(goal.made(), rig.over(known.convention))
    with progress("optimise", quiet=output.json_) as advance:
        found = search(
            _bounds(sought.vary),
            design=design,
            material=plastic.over(known.material),
            scoring=scoring,
            workers=workers.made(),
            on_progress=advance,
        )
    output.hand_out(found)
    return 0


def _bounds(text: str) -> dict[str, tuple[float, float]]:
    found = {}
    for name, ends in pairs_of(text, "--vary", "NAME=FROM:TO,…").items():
        low, colon, high = ends.partition(":")
        if not colon:
            raise UsageError(f"--vary takes NAME=FROM:TO, such as ridge_angle=3:20, not {name}={ends}")
        found[name] = (one_number(low, "--vary"), one_number(high, "--vary"))
    return found


def _pair(text: str) -> tuple[float, float]:
    numbers = parse_numbers(text, "--pair")
    if len(numbers) != 2 or numbers[0] == numbers[1]:
        raise UsageError(f"--pair takes two different stage angles, such as 0,90, not {text!r}")
    return numbers[0], numbers[1]


def _noise(text: str | None) -> "Noise":
    from anisoscope.study.objective import Noise

    return (
        Noise() if text is None else Noise(**named_numbers(text, "--noise", "floor=VALUE,share=VALUE", Noise))
    )


def _tolerances(text: str) -> "Tolerances":
    from anisoscope.study.objective import Tolerances

    return Tolerances(**named_numbers(text, "--scatter", "NAME=SD,…", Tolerances))

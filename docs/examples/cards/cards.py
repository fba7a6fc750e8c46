"""A kind of part of our own for anisoscope: matt cards, of which only the mean brightness is judged."""

from dataclasses import dataclass

import numpy as np

from anisoscope.kinds.plugin import (
    CommandOutput,
    Convention,
    Details,
    Grid,
    Judgement,
    Kind,
    Part,
    Pictures,
    Positive,
    Prediction,
    RadianceSet,
    RecipeBase,
    Record,
    Reference,
    References,
    Reporting,
    Results,
    RigFile,
    Sections,
    Sitting,
    Table,
    Verdict,
    View,
    check_light,
    check_view,
    mean_of,
    most_changed,
    resample,
    usable,
)


class CardPart(Part):
    """What a good card shows: its mean radiance in 1/sr, and how far it may be off."""

    radiance: Positive
    limit: Positive


class CardRecipe(RecipeBase):
    """The recipe of a card: the tables of all kinds, and [card]."""

    card: CardPart


class CardDetails(Details):
    """Its part of record.json."""

    mean: float
    limit: float

    def numbers(self) -> dict[str, float]:
        """What the history and the control charts take."""
        return {"card radiance": self.mean}


@dataclass(frozen=True, eq=False)
class Measured:
    """Mean radiances of the poses."""

    radiance: np.ndarray
    drift: float | None


class Cards(Kind[CardRecipe, Prediction, Measured, Judgement], References, Reporting):
    """Matt cards."""

    name = "cards"
    one = "a card"
    recipe = CardRecipe
    details = CardDetails
    reference_set = RadianceSet

    def predict(self, recipe: CardRecipe, rig: RigFile, *, cached: bool) -> Prediction:  # noqa: ARG002
        """The same radiance in all poses."""
        return Prediction(recipe.poses.poses(), Convention(rig.light.angle_deg), "card")

    def measure(self, sitting: Sitting, recipe: CardRecipe, expected: Prediction) -> tuple[Measured, float]:  # noqa: ARG002
        """The mean of the region in every pose, after the gates of light and markers."""
        height, width = recipe.region.size_mm[1], recipe.region.size_mm[0]
        step = sitting.pixel_um / 1000.0
        grid = Grid(recipe.region.center_mm, step, (round(height / step), round(width / step)))

        def mean(view: View) -> float:
            return mean_of(resample(view.image.value, view.placement, grid))

        views = sitting.views
        closing, change = most_changed(views, recipe, sitting.pixel_um, mean)
        for view in views.poses:
            check_light(view.stage_deg, view.image, recipe)
            check_view(view, views.poses[0], recipe, sitting.pixel_um)
        radiance = np.array([mean(view) for view in views.poses])
        drift = None if closing is None else mean(closing) / float(radiance[0]) - 1.0
        return Measured(radiance, drift), change

    def decide(
        self,
        sitting: Sitting,  # noqa: ARG002
        recipe: CardRecipe,
        expected: Prediction,  # noqa: ARG002
        measured: Measured,
        reference: Reference | None,
    ) -> Judgement:
        """One threshold on the mean, and the ratios of the poses as on good cards, if there are enough of them."""
        off = float(measured.radiance.mean()) - recipe.card.radiance
        reasons = (f"the card is off by {off:+.3f} 1/sr (limit {recipe.card.limit:g})",)
        good = usable(reference)
        if isinstance(good, RadianceSet):
            _, _, p_value = good.t_squared(measured.radiance, np.full(measured.radiance.size, 0.01))
            if p_value < recipe.decision.alpha:
                return Judgement(Verdict.FAIL, (f"not like the good cards (p = {p_value:.2g})", *reasons))
        return Judgement(Verdict.PASS if abs(off) <= recipe.card.limit else Verdict.FAIL, reasons)

    def results(
        self,
        sitting: Sitting,  # noqa: ARG002
        recipe: CardRecipe,
        expected: Prediction,
        measured: Measured,
        decided: Judgement,  # noqa: ARG002
        reference: Reference | None,  # noqa: ARG002
    ) -> Results:
        """What the record holds."""
        details = CardDetails(mean=float(measured.radiance.mean()), limit=recipe.card.limit)
        return Results(measured.radiance, np.full(len(expected.poses), recipe.card.radiance), details)

    def sections(self, record: Record, pictures: Pictures) -> Sections:  # noqa: ARG002
        """A heading of its own in the report."""
        source = "{% if card %}<h2>The card</h2><p>Mean radiance {{ '%.4f'|format(card.mean) }} 1/sr.</p>{% endif %}"
        return Sections(rule="one threshold on the mean", before=source, content={"card": record.details})

    def summary(self, record: Record) -> CommandOutput:
        """What `anisoscope inspect` prints."""
        found = record.details
        if not isinstance(found, CardDetails):
            return CommandOutput({"card": None})
        rows = [[f"{found.mean:.4f}", f"{found.limit:g}"]]
        return CommandOutput(
            {"card": found.model_dump()}, (Table(record.serial, ["mean [1/sr]", "limit"], rows),)
        )


CARDS = Cards()

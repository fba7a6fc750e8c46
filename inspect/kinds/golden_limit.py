"""Text on the origin of the area limit, for golden parts and golden prints."""

from anisoscope.imaging.area_limit import MIN_PARTS


def area_limit_text(
    stated: float | None,
    learnt: float | None,
    count: int,
    *,
    given: bool,
    things: str,
    exceeds: str,
    judged: str,
) -> str:
    """One line about the limit of the area.

    Args:
        stated: the recipe's limit or its default, a share; None where the area is not judged.
        learnt: the limit that the golden set gives, a share; None while it gives none.
        count: how many of the set count for it.
        given: whether the recipe states its limit.
        things: "parts" or "prints".
        exceeds: how often a good one exceeds the learnt limit, and what shares its level.
        judged: how they must have been judged.
    """
    if stated is None:
        return "limit of the area: none, the recipe does not judge it"
    if learnt is not None:
        return f"limit of the area: {learnt:.2%}, learnt from {count} golden {things} ({exceeds})"
    if given:
        return f"limit of the area: {stated:.2%}, as the recipe says in area.max_share"
    return (
        f"limit of the area: {stated:.2%}; from {MIN_PARTS} golden {things} judged {judged} on it is learnt from "
        f"them, now there are {count}"
    )

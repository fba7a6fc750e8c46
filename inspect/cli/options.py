"""Options that the commands share."""

from typing import Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError

Json = Annotated[bool, Parameter(name="--json", negative="", help="Print JSON.")]


def parse_numbers(text: str, option: str, example: str = "0,90,180") -> tuple[float, ...]:
    """Numbers of a comma-separated option.

    Raises:
        UsageError: the text is not a list of finite numbers.
    """
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(
            f"{option} takes numbers separated by commas, such as {example}, not {text!r}"
        ) from None
    if not all(abs(number) < float("inf") for number in numbers):
        raise UsageError(f"{option} takes finite numbers, not {text!r}")
    return numbers

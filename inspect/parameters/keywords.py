"""Operations that take a parameter model, or its fields as keywords."""

from collections.abc import Callable
from dataclasses import MISSING, fields
from functools import wraps
from inspect import Parameter, signature
from typing import Any, TypeVar, cast

R = TypeVar("R")


def by_keywords(**models: type) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Decorator: a caller states the fields of parameter models as keywords, or hands over the models.

    Args:
        models: keyword parameter of the function -> its model, a frozen dataclass.
    """

    def mark(function: Callable[..., R]) -> Callable[..., R]:
        own = signature(function)

        @wraps(function)
        def call(*given: Any, **named: Any) -> R:  # noqa: ANN401 - of any operation
            for parameter, model in models.items():
                if parameter not in named:
                    stated = [one.name for one in fields(model) if one.name in named]
                    named[parameter] = model(**{name: named.pop(name) for name in stated})
            return function(*given, **named)

        shown = [one for one in own.parameters.values() if one.name not in models]
        for model in models.values():
            for one in fields(model):
                default = Parameter.empty if one.default is MISSING else one.default
                shown.append(
                    Parameter(one.name, Parameter.KEYWORD_ONLY, default=default, annotation=one.type)
                )
        cast("Any", call).__signature__ = own.replace(parameters=shown)
        return call

    return mark

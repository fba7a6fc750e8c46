"""Commands and options of the version before, which are still understood and no longer shown."""

from collections.abc import Sequence

COMMANDS = {
    ("code",): ("read-code",),
    ("experiment", "ridges"): ("research", "experiment"),
    ("experiment", "findings"): ("research", "findings"),
    ("experiment",): ("research",),
    ("study",): ("research",),
}
"""Words of the version before -> words of today; the longer ones first."""
OPTIONS: dict[tuple[str, ...], dict[str, str]] = {}
"""Command of today -> its options of the version before and of today."""


def of_today(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """A command line in the words of today, and a remark for every word that was replaced.

    Args:
        arguments: the command line, without the program.
    """
    found, remarks = list(arguments), []
    for old, new in COMMANDS.items():
        if tuple(found[: len(old)]) == old:
            found[: len(old)] = new
            remarks.append(f"`{' '.join(old)}` is `{' '.join(new)}` now")
            break
    for command, options in OPTIONS.items():
        if tuple(found[: len(command)]) == command:
            found = [_renamed(token, options, remarks) for token in found]
    return found, remarks


def _renamed(token: str, options: dict[str, str], remarks: list[str]) -> str:
    name, equals, value = token.partition("=")
    if name not in options:
        return token
    remarks.append(f"`{name}` is `{options[name]}` now")
    return options[name] + equals + value

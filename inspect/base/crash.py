"""Errors that nothing foresaw: the traceback goes to a file, one line names it."""

from importlib.metadata import version


def crash_line(error: Exception, during: str) -> str:
    """Write the traceback of an error to a new file in the folder for temporary files; one line names both.

    Args:
        error: the error.
        during: what was being done: a command line, a folder.
    """
    import tempfile  # noqa: PLC0415 - errors are rare
    import traceback  # noqa: PLC0415 - errors are rare

    lines = [during, f"version {version('anisoscope')}", "", "".join(traceback.format_exception(error))]
    try:
        with tempfile.NamedTemporaryFile(
            "w", encoding="utf-8", prefix="anisoscope-crash-", suffix=".log", delete=False
        ) as file:
            file.write("\n".join(lines))
        where = f"the details are in {file.name}; report it with that file"
    except OSError:
        where = "run the command again with --debug, and report it with what that prints"
    return f"internal error ({type(error).__name__}: {error}): this is no verdict; {where}"

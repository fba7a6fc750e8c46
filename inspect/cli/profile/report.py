"""``anisoscope profile report``: a height map and its ridges on one HTML page."""

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.console import progress
from anisoscope.cli.profile.profile import AS_STATED, Scales


def report(
    file: Path,
    /,
    *,
    out: Path,
    force: Annotated[bool, Parameter(negative="")] = False,
    scales: Annotated[Scales, Parameter(name="*")] = AS_STATED,
) -> int:
    """Write one HTML page about a height map: pictures, ridges, roughness, burrs, height parameters, origin.

    Args:
        file: Height map; one without ridges gets a page without them.
        out: HTML file to write.
        force: Overwrite a file that exists.
    """
    from anisoscope.report.profile_page import write_profile_page

    if out.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--out {out}: a page is named *.html")
    if out.exists() and not force:
        raise UsageError(f"--out {out} exists already; choose another name, or say --force")
    with progress(file.name) as advance:
        advance("reading", 0, 3)
        surface = scales.read(file)
        write_profile_page(surface, file.name, out, advance)
    sys.stdout.write(f"{out}\n")
    return 0

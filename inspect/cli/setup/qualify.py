"""``anisoscope qualify``: evidence that this installation is as released (IQ) and computes what it should (OQ)."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisoscope.base.errors import RecordError, UsageError
from anisoscope.cli.json_output import as_json
from anisoscope.cli.options import Json, TrustFile
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import answer


def qualify(
    *,
    out: Path = Path("qualifications"),
    rig: Annotated[Path | None, Parameter(name=["--rig", "-g"])] = None,
    exposure: float | None = None,
    code: str | None = None,
    check: Path | None = None,
    trust: TrustFile = None,
    json_: Json = False,
) -> int:
    """Write evidence that this installation is as released (IQ) and computes what it should (OQ).

    Checks versions, files and calibrations, compares computed with known values, inspects three parts on the virtual
    rig and shows that changed records are found. The page is signed, and prints on A4.

    Exit codes: 0 PASS, 1 FAIL, 64 and above an error.

    Args:
        out: Folder that receives a folder with the evidence.
        exposure: Exposure in seconds for the self test of the rig: the stage homes and turns. Left out, not tested.
        code: SHA-256 of the code that was released for use, as an earlier page states it.
        check: Verify the evidence in a folder instead: its hashes and its signature.
        rig: Rig file: devices and calibrations are checked, too.

    Examples:
        anisoscope qualify
        anisoscope qualify --rig rig.toml --exposure 0.006 --out quality/rig-1
        anisoscope qualify --check quality/rig-1/qualification-20260301T080000Z --trust keys.toml
    """
    from anisoscope.base.signature import read_trust
    from anisoscope.operations.qualification import REPORT, verified, write_evidence
    from anisoscope.operations.qualification import qualify as qualified

    if check is not None:
        words, good = verified(check, None if trust is None else read_trust(trust))
        answer({"folder": str(check), "verified": good, "finding": words}, [f"{check}: {words}"], json_=json_)
        return 0 if good else 1
    if exposure is not None and rig is None:
        raise UsageError("--exposure goes with --rig")
    began = datetime.now(UTC)
    folder = out / f"qualification-{began:%Y%m%dT%H%M%SZ}"
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise RecordError(f"cannot make the folder {folder}: {error.strerror}") from error
    with progress("qualification", quiet=json_) as advance:
        found = qualified(folder, began, rig, exposure, code, advance)
    signature = write_evidence(folder, found)
    failed = [one for one in found.lines if one.outcome == "FAIL"]
    lines = [f"FAIL  {one.what}: {one.found}; accepted: {one.limit}" for one in failed]
    lines.append(f"{found.result}: {len(failed)} of {len(found.lines)} lines fail; {folder / REPORT}")
    lines.append(signature)
    answer({**as_json(found), "result": found.result, "folder": str(folder)}, lines, json_=json_)
    return 0 if found.result == "PASS" else 1

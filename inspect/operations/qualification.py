"""Evidence that this installation is as released (IQ) and computes what it should (OQ).

The expected values are closed forms, written out here, and published numbers; nothing of the code under test is used
for them.
"""

import json
import math
import platform
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from anisoscope.base.errors import AnisoscopeError, ConfigError, RecordError
from anisoscope.base.json_fields import as_json
from anisoscope.base.progress import Advance, silent

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from anisoscope.base.signature import Trust

    Floats = npt.NDArray[np.float64]

REPORT, RESULT, SIGNATURE = "qualification.html", "qualification.json", "qualification.signature.json"
PARTS = {
    "IQ": "Installation",
    "OQ": "Operation: closed forms and published values",
    "OQ-R": "Operation: reference inspections and their records",
    "RIG": "Rig",
}
SEED = 1
Outcome = Literal["PASS", "FAIL", "NOTE"]


@dataclass(frozen=True)
class Line:
    """One check; a NOTE has no acceptance limit.

    Attributes:
        part: IQ, OQ, OQ-R or RIG.
        what: what was looked at.
        found: what was found.
        limit: what is accepted.
        outcome: whether it is.
        source: where the expected value is from.
    """

    part: str
    what: str
    found: str
    limit: str
    outcome: Outcome
    source: str = ""


@dataclass(frozen=True)
class Qualification:
    """The evidence: when (UTC), where, of which version, and all lines."""

    created_at: str
    computer: str
    software: str
    code_sha256: str
    duration_s: float
    lines: tuple[Line, ...]

    @property
    def result(self) -> Outcome:
        """FAIL where a line fails."""
        return "FAIL" if any(one.outcome == "FAIL" for one in self.lines) else "PASS"


def qualify(
    folder: Path,
    began: datetime,
    rig: Path | None = None,
    exposure_s: float | None = None,
    code: str | None = None,
    on_progress: Advance = silent,
) -> Qualification:
    """Compare this installation with its release, known values with computed ones, and records with their frames.

    Args:
        folder: receives the inspections of the reference parts.
        began: when the qualification began, UTC.
        rig: rig file whose devices and calibrations are checked, too.
        exposure_s: of the self test of the rig, for which the stage homes and turns; None tests none.
        code: SHA-256 of the code that was released for use.
        on_progress: called with the part that begins, its number and the number of parts.

    Raises:
        AnisoscopeError: the rig file cannot be read.
    """
    from importlib.metadata import version

    advance = on_progress
    digest, changed, count = code_digest()
    lines = []
    parts: list[tuple[str, Callable[[], Iterator[Line]]]] = [
        ("installation", lambda: _installation(rig, code, digest, changed, count)),
        ("known values", _known_values),
        ("reference inspections", lambda: _references(folder, advance)),
    ]
    if rig is not None:
        parts.append(("rig", lambda: _rig_lines(rig, exposure_s, advance)))
    for number, (name, part) in enumerate(parts):
        advance(name, number, len(parts))
        lines += list(part())
    return Qualification(
        began.isoformat(timespec="seconds"),
        f"{platform.node()}, {platform.platform()}",
        f"anisoscope {version('anisoscope')}",
        digest,
        round((datetime.now(UTC) - began).total_seconds(), 1),
        tuple(lines),
    )


# ---- installation ---------------------------------------------------------------------------------------------------


def code_digest() -> tuple[str, tuple[str, ...], int]:
    """SHA-256 of all sources of this program, by name; files that are not as packaged; how many the package lists.

    An editable installation lists none.
    """
    import base64
    import hashlib
    from importlib.metadata import distribution

    import anisoscope

    whole, listed, changed = hashlib.sha256(), 0, []
    roots = sorted({Path(one).resolve() for one in anisoscope.__path__})
    sources = {
        path
        for root in roots
        for path in root.rglob("*")
        if path.suffix in {".py", ".html", ".js", ".csv", ".mo"}
    }
    for name, path in sorted((_name(path, roots), path) for path in sources):
        whole.update(f"{name}\0{hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    for file in distribution("anisoscope").files or ():
        if file.hash is None or not str(file).startswith("anisoscope/"):
            continue
        listed += 1
        try:
            found = hashlib.new(file.hash.mode, file.locate().read_bytes()).digest()  # type: ignore[attr-defined]
        except OSError:
            found = b""
        if base64.urlsafe_b64encode(found).rstrip(b"=").decode() != file.hash.value:
            changed.append(str(file))
    return whole.hexdigest(), tuple(changed), listed


def _name(path: Path, roots: Sequence[Path]) -> str:
    return next(path.relative_to(root).as_posix() for root in roots if path.is_relative_to(root))


def _installation(
    rig: Path | None, code: str | None, digest: str, changed: tuple[str, ...], listed: int
) -> Iterator[Line]:
    from importlib.metadata import PackageNotFoundError, metadata, requires, version

    from packaging.requirements import Requirement
    from packaging.specifiers import SpecifierSet

    from anisoscope.operations.installation import findings

    known = "" if code is None else code.lower()
    outcome: Outcome = "NOTE" if code is None else "PASS" if known == digest else "FAIL"
    yield Line("IQ", "code of this program, SHA-256", digest, known or "stated", outcome, "--code")
    if listed:
        words = f"{listed} files as packaged" if not changed else f"changed: {', '.join(changed[:3])}"
        yield Line(
            "IQ",
            "installed files",
            words,
            "all as packaged",
            "FAIL" if changed else "PASS",
            "RECORD of the package",
        )
    else:
        words = "an editable installation: the package lists no files"
        yield Line("IQ", "installed files", words, "stated", "NOTE")
    supported = SpecifierSet(metadata("anisoscope")["Requires-Python"])
    good = supported.contains(platform.python_version(), prereleases=True)
    yield Line(
        "IQ", "Python", sys.version.split("\n")[0], str(supported), "PASS" if good else "FAIL", "package"
    )
    for text in requires("anisoscope") or ():
        wanted = Requirement(text)
        if wanted.marker is not None and not wanted.marker.evaluate({"extra": ""}):
            continue
        limit = str(wanted.specifier) or "any"
        try:
            there = version(wanted.name)
        except PackageNotFoundError:
            yield Line("IQ", f"package {wanted.name}", "not installed", limit, "FAIL", "package")
            continue
        good = wanted.specifier.contains(there, prereleases=True)
        yield Line("IQ", f"package {wanted.name}", there, limit, "PASS" if good else "FAIL", "package")
    states: dict[str, Outcome] = {"ok": "PASS", "note": "NOTE", "missing": "FAIL"}
    for one in findings(rig, None):
        limit = "no fault" if one.state != "note" else "stated"
        part = (
            "RIG" if one.what.startswith(("rig", "stage", "camera", "light", "tilt", "calibration")) else "IQ"
        )
        if part == "IQ" or rig is not None:
            yield Line(part, one.what, one.text, limit, states[one.state], "doctor")
    yield _key()


def _key() -> Line:
    from anisoscope.base.signature import key_id, signer_in_use

    try:
        signer = signer_in_use()
    except ConfigError as error:
        return Line("IQ", "signing key", str(error), "usable", "FAIL")
    if signer is None:
        return Line("IQ", "signing key", "none: nothing is signed", "stated", "NOTE")
    return Line("IQ", "signing key", key_id(signer.public), "usable", "PASS")


# ---- known values ---------------------------------------------------------------------------------------------------


def close(what: str, found: float | None, expected: float, within: float, source: str) -> Line:
    """A line for a number that has to be within a distance of another one."""
    value = math.nan if found is None else found
    good: Outcome = "PASS" if abs(value - expected) <= within else "FAIL"
    return Line("OQ", what, f"{value:.6g}", f"{expected:.6g} ± {within:.2g}", good, source)


def _known_values() -> Iterator[Line]:
    for part in (_light, _waves, _surfaces, _colours, _statistics, _proofs):
        try:
            yield from part()
        except Exception as error:  # noqa: BLE001 - a broken installation fails anywhere, and is to say where
            words = " ".join(str(error).split()) or type(error).__name__
            yield Line("OQ", part.__name__.strip("_"), f"{type(error).__name__}: {words}", "computed", "FAIL")


def _light() -> Iterator[Line]:
    import numpy as np

    from anisoscope.experiment.experiment import Setup, run_experiment
    from anisoscope.parameters.material import Material
    from anisoscope.sim.light.material import brdf_table, fresnel

    at = np.array([1.0, np.cos(np.arctan(1.5))])
    head, brewster = fresnel(at, 1.5)
    yield close(
        "reflectance of a dielectric at 0°, n = 1.5", head, (0.5 / 2.5) ** 2, 1e-12, "Fresnel: ((n−1)/(n+1))²"
    )
    half = 0.5 * ((1.5**2 - 1.0) / (1.5**2 + 1.0)) ** 2
    yield close("the same at Brewster's angle", brewster, half, 1e-12, "Fresnel: ½((n²−1)/(n²+1))²")
    rng = np.random.default_rng(SEED)
    ways = rng.standard_normal((40, 3))
    ways[:, 2] = np.abs(ways[:, 2]) + 0.2
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    table = np.asarray(brdf_table(ways, ways, Material()))
    asymmetry = float(np.max(np.abs(table - table.T) / table))
    yield close(
        "reflectance with light and camera exchanged, largest relative change",
        asymmetry,
        0.0,
        1e-9,
        "Helmholtz",
    )
    found = run_experiment(Setup()).findings.as_published
    words = "hold" if found else "do not hold"
    yield Line(
        "OQ",
        "findings of the ridge experiment",
        words,
        "hold",
        "PASS" if found else "FAIL",
        "Luongo et al. 2017, section 4",
    )


def _waves() -> Iterator[Line]:
    import numpy as np

    from anisoscope.profiles.etching import Etched
    from anisoscope.sim.light.wave.orders import Orders, level_phases

    labels = np.zeros((8, 64), dtype=np.uint8)
    labels[:, :32] = 1
    quarter = 0.5 / 4.0
    for depth, name in ((quarter, "λ/4"), (quarter / 2.0, "λ/8")):
        tile = Etched(labels, (depth,), 0.125)
        waves = Orders.of(tile).around(
            (0.0, 0.0), (0.13, 0.01), level_phases(np.asarray(tile.levels_um), 0.5, 1.0)
        )[0]
        power = np.abs(waves[0]) ** 2
        middle = power.size // 2
        turn = 4.0 * np.pi * depth / 0.5
        orders = ((0, np.cos(turn / 2.0) ** 2), (1, (2.0 / np.pi * np.sin(turn / 2.0)) ** 2))
        for order, expected in orders:
            what = f"grating of two levels, depth {name}: power in order {order}"
            yield close(
                what,
                float(power[middle + order]),
                float(expected),
                1e-5,
                "Fourier series of a binary grating",
            )


def _surfaces() -> Iterator[Line]:
    from anisoscope.parameters.ridges import RidgeDesign
    from anisoscope.profiles.ideal import ridges
    from anisoscope.profiles.metrology.ridges import measure_ridges

    found = measure_ridges(ridges(RidgeDesign(pitch_um=100.0, ridge_angle_deg=10.0), (400, 800), (1.0, 1.0)))
    yield close("pitch of ideal ridges, measured, in µm", found.pitch_um.value, 100.0, 0.01, "design")
    yield close("their ridge angle in °", found.ridge_angle_deg.value, 10.0, 0.02, "design")


SHARMA = (
    ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
    ((50.0, 2.5, 0.0), (50.0, 0.0, -2.5), 4.3065),
    ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
)


def _colours() -> Iterator[Line]:
    import numpy as np

    from anisoscope.sim.light.colour.illuminant import standard
    from anisoscope.sim.light.colour.observer import white_point
    from anisoscope.sim.light.colour.spaces import ciede2000

    for first, second, expected in SHARMA:
        found = float(ciede2000(np.array(first), np.array(second)))
        yield close(
            f"CIEDE2000 of {first} and {second}", found, expected, 1e-4, "Sharma, Wu, Dalal 2005, table 1"
        )
    white = white_point(standard("D65"))
    for name, value, expected in zip("xy", white / white.sum(), (0.31272, 0.32903), strict=False):
        yield close(f"D65, {name}", float(value), expected, 2e-4, "CIE 15:2004, table T.3")


FLOW_RATE = (49.6, 47.6, 49.9, 51.3, 47.8, 51.2, 52.6, 52.4, 53.6, 52.1)
AIAG_BIAS = (5.8, 5.7, 5.9, 5.9, 6.0, 6.1, 6.0, 6.1, 6.4, 6.3, 6.0, 6.1, 6.2, 5.6, 6.0)


def _statistics() -> Iterator[Line]:
    import numpy as np
    from scipy.special import chdtrc

    from anisoscope.decision.decision import guarded
    from anisoscope.quality.bias import bias_study
    from anisoscope.quality.limits import individuals, limits_of

    limits = limits_of(individuals(np.array(FLOW_RATE)))
    nist = "NIST/SEMATECH e-Handbook 6.3.2.2"
    yield close("individuals chart of a flow rate, centre", limits.center, 50.81, 1e-9, nist)
    yield close("the same, upper limit", limits.center + 3.0 * limits.sigma, 55.8041, 2e-3, nist)
    bias = bias_study(np.array(AIAG_BIAS), 6.0)
    yield close("bias of fifteen measurements", bias.bias, 0.0067, 5e-5, "AIAG MSA, 4th edition, III-B")
    yield close(
        "χ² of three contrasts exceeded by chance", float(chdtrc(3.0, 16.266)), 0.001, 1e-6, "table of χ²"
    )
    for value, expected in ((0.1, "PASS"), (0.19, "INCONCLUSIVE"), (0.25, "FAIL")):
        verdict = guarded(value, 0.01, 0.2, 2.0)[0].value
        what = f"deviation {value:g} of tolerance 0.2, u = 0.01, guard band 2 u"
        yield Line("OQ", what, verdict, expected, "PASS" if verdict == expected else "FAIL", "JCGM 106, 8.3")


RFC_KEY = "4ccd089b28ff96da9db6c346ec114e0f5b8a319f35aba624da8cf6ed4fb8a6fb"
RFC_SIGNATURE = (
    "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da"
    "085ac1e43e15996e458f3613d0f11d8c387b2eaeb4302aeeb00d291612bb0c00"
)
FIPS_ABC = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


def _proofs() -> Iterator[Line]:
    import hashlib

    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    signature = Ed25519PrivateKey.from_private_bytes(bytes.fromhex(RFC_KEY)).sign(b"\x72").hex()
    for what, found, expected, source in (
        ("Ed25519 signature of one byte", signature, RFC_SIGNATURE, "RFC 8032, 7.1, test 2"),
        ("SHA-256 of “abc”", hashlib.sha256(b"abc").hexdigest(), FIPS_ABC, "FIPS 180-4, example"),
    ):
        good = found == expected
        yield Line("OQ", what, f"{found[:16]}…", f"{expected[:16]}…", "PASS" if good else "FAIL", source)


# ---- reference inspections ------------------------------------------------------------------------------------------


def _references(folder: Path, advance: Advance) -> Iterator[Line]:
    """Inspect the parts of the demo, judge one again, and damage copies of it."""
    from importlib import import_module

    from anisoscope.history.address import HISTORY_NAME
    from anisoscope.inspection.integrity import verify
    from anisoscope.inspection.recompute import recompute
    from anisoscope.inspection.run import inspect_part
    from anisoscope.operations.remembering import remember

    scene = import_module("anisoscope.operations.demo.ridges").SCENE
    try:
        place = scene.lay_out(folder / "reference", SEED, advance)
        history = place / "inspections" / HISTORY_NAME
        done = None
        for name, expected in scene.parts.items():
            rig = place / "bench" / name / "rig.toml"
            done = inspect_part(place / "recipe.toml", rig, f"QUALIFY-{name}", place / "inspections", advance)
            remember(done, history)
            verdict = done.record.verdict
            outcome: Outcome = "PASS" if verdict == expected else "FAIL"
            yield Line("OQ-R", f"part “{name}” on the virtual rig", verdict, expected, outcome, "made so")
        assert done is not None
        found = verify(done.folder)
        words = f"{found.files} files, {'none' if found.intact else 'some'} changed"
        yield Line(
            "OQ-R", "`verify` of an inspection", words, "none changed", "PASS" if found.intact else "FAIL"
        )
        differences = recompute(done.folder).differences
        words = f"{len(differences)} numbers differ"
        yield Line(
            "OQ-R",
            "`recompute` from its frames",
            words,
            "0 numbers differ",
            "FAIL" if differences else "PASS",
        )
        yield from _forgeries(done.folder, history)
    except AnisoscopeError as error:
        yield Line("OQ-R", "reference inspections", " ".join(str(error).split()), "finished", "FAIL")


def _forgeries(inspection: Path, history: Path) -> Iterator[Line]:
    """Change a frame, a number of the record, and a row of the history, in copies; each has to be found."""
    import shutil
    import sqlite3
    import tempfile

    from anisoscope.history.store import open_history
    from anisoscope.inspection.integrity import verify

    def changed(name: str, what: str, edit: Callable[[bytes], bytes]) -> Line:
        path = copy / name
        content = path.read_bytes()
        path.chmod(0o644)
        path.write_bytes(edit(content))
        found = name in verify(copy).changed
        path.write_bytes(content)
        return Line(
            "OQ-R", what, "found" if found else "not found", "found", "PASS" if found else "FAIL", "copy"
        )

    with tempfile.TemporaryDirectory(prefix="anisoscope-") as scratch:
        copy = Path(scratch) / inspection.name
        shutil.copytree(inspection, copy)
        frame = next(path for path in sorted((copy / "frames").iterdir()) if path.suffix == ".tif")
        name = frame.relative_to(copy).as_posix()
        yield changed(name, "one bit of a frame changed", lambda data: data[:-1] + bytes([data[-1] ^ 1]))
        yield changed("record.json", "PASS and FAIL exchanged in a record", _exchanged)
        with open_history(history, create=False) as before:
            intact = not before.verify_chain()
        yield Line(
            "OQ-R",
            "history as it was written",
            "intact" if intact else "damaged",
            "intact",
            "PASS" if intact else "FAIL",
        )
        other = Path(scratch) / history.name
        shutil.copyfile(history, other)
        with sqlite3.connect(other) as connection:
            triggers = connection.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall()
            for (trigger,) in triggers:
                connection.execute(f'DROP TRIGGER "{trigger}"')
            connection.execute(
                "UPDATE inspections SET verdict = CASE verdict WHEN 'PASS' THEN 'FAIL' ELSE 'PASS' END"
            )
        connection.close()
        with open_history(other, create=False) as after:
            found = bool(after.verify_chain())
        words = "found" if found else "not found"
        yield Line(
            "OQ-R",
            "PASS and FAIL exchanged in a history",
            words,
            "found",
            "PASS" if found else "FAIL",
            "copy",
        )


def _exchanged(record: bytes) -> bytes:
    passed, failed = b'"verdict": "PASS"', b'"verdict": "FAIL"'
    return record.replace(passed, b"\0").replace(failed, passed).replace(b"\0", failed)


# ---- rig ------------------------------------------------------------------------------------------------------------


def _rig_lines(rig: Path, exposure: float | None, advance: Advance) -> Iterator[Line]:
    from anisoscope.calibration.corrections import list_calibrations
    from anisoscope.commissioning.selftest import self_test
    from anisoscope.commissioning.selftest_record import Settings

    try:
        for one in list_calibrations(rig):
            if one.taken_at is not None:
                age = (datetime.now(UTC) - _utc(one.taken_at)).total_seconds() / 86400.0
                good = one.state == "valid"
                limit = "stated" if one.valid_until is None else f"valid until {one.valid_until}"
                outcome: Outcome = "NOTE" if one.valid_until is None else "PASS" if good else "FAIL"
                yield Line(
                    "RIG",
                    f"age of the calibration {one.kind}",
                    f"{age:.1f} days",
                    limit,
                    outcome,
                    one.id or "",
                )
        if exposure is None:
            yield Line("RIG", "self test", "not asked for: --exposure", "stated", "NOTE")
            return
        found = self_test(rig, Settings(exposure_s=exposure), None, on_progress=advance)
    except AnisoscopeError as error:
        yield Line("RIG", "self test", " ".join(str(error).split()), "finished", "FAIL")
        return
    for table, device in found.devices.items():
        yield Line("RIG", f"device: {table}", device, "answers", "PASS")
    outcomes: dict[str, Outcome] = {"PASS": "PASS", "FAIL": "FAIL", "WARN": "NOTE", "SKIPPED": "NOTE"}
    for check in found.checks:
        value = check.remark if check.value is None else f"{check.value:.4g} {check.unit}".strip()
        limit = "stated" if check.limit is None else f"{check.limit:.4g} {check.unit}".strip()
        yield Line("RIG", check.words, value, limit, outcomes[check.outcome], "rig check")


def _utc(text: str) -> datetime:
    moment = datetime.fromisoformat(text)
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment


# ---- the evidence ---------------------------------------------------------------------------------------------------


def write_evidence(folder: Path, found: Qualification) -> str:
    """Write page, numbers and signature; what was signed, in words.

    Raises:
        RecordError: the folder cannot be written.
    """
    from anisoscope.base.atomic_write import write_text
    from anisoscope.base.signature import key_id, signed, signer_in_use
    from anisoscope.record.schema import sha256_of
    from anisoscope.report.page import write_page

    try:
        signer = signer_in_use()
    except ConfigError:  # a line says so
        signer = None
    content = {**as_json(found), "result": found.result}
    write_text(folder / RESULT, json.dumps(content, indent=1, ensure_ascii=False) + "\n")
    groups = [(name, [one for one in found.lines if one.part == part]) for part, name in PARTS.items()]
    counts = {word: sum(one.outcome == word for one in found.lines) for word in ("PASS", "FAIL", "NOTE")}
    page = {
        "title": f"Qualification of an installation, {found.created_at[:10]}",
        "found": found,
        "result": found.result,
        "groups": [(name, lines) for name, lines in groups if lines],
        "counts": counts,
        "numbers_sha256": sha256_of(folder / RESULT),
        "key": "none: this page is not signed" if signer is None else f"{key_id(signer.public)}: {SIGNATURE}",
    }
    write_page(folder / REPORT, "qualification.html", page)
    if signer is None:
        return "not signed: no signing key (`anisoscope init` makes one)"
    statement = {name: sha256_of(folder / name) for name in (REPORT, RESULT)}
    statement |= {"result": found.result, "software": found.software, "created_at": found.created_at}
    write_text(folder / SIGNATURE, signed("qualification", statement, signer) + "\n")
    return f"signed with {key_id(signer.public)}: {folder / SIGNATURE}"


def verified(folder: Path, trust: "Trust | None") -> tuple[str, bool]:
    """What is to be said of evidence in a folder, and whether it holds: hashes, signature, and with trust its key.

    Raises:
        RecordError: there is no signature, or it cannot be read.
    """
    from anisoscope.base.regular_file import bounded_bytes
    from anisoscope.base.signature import read_signed
    from anisoscope.record.schema import sha256_of

    path = folder / SIGNATURE
    try:
        found = read_signed("qualification", bounded_bytes(path))
        changed = [name for name in (REPORT, RESULT) if found.content.get(name) != sha256_of(folder / name)]
    except OSError as error:
        raise RecordError(f"{error.filename or path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        return f"{SIGNATURE}: {error}", False
    if changed:
        return f"changed since it was signed: {', '.join(changed)}", False
    doubt = None if trust is None else trust.distrust(found)
    who = found.key if trust is None else trust.station(found)
    return (
        doubt
        or f"{found.content['result']}, unchanged, signed by {who} at {found.signed_at:%Y-%m-%d %H:%M} UTC",
        doubt is None,
    )

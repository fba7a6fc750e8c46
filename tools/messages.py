"""Messages of the operator's path: brings the catalogues up to date and compiles them.

A message is what a template writes as ``_("…")``, what `message` is called with, an entry of the tables of causes,
actions and verdicts, and the sentences of the definitions in `SENTENCES`, whose f-strings become patterns with named
places. ``python tools/messages.py`` adds new messages to the catalogues without translation, drops those that have
gone, and compiles. A test finds what has no translation.
"""

import ast
import io
import re
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from babel.messages.catalog import Catalog
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po, write_po

from anisoscope.base.notation import NUMBER_WORDS
from anisoscope.commissioning.selftest import STEPS
from anisoscope.diagnosis.causes import all_causes
from anisoscope.diagnosis.discriminating_poses import TILTS_DEG
from anisoscope.diagnosis.ranking import bare_title
from anisoscope.imaging.mark_classes import TEXTURE, UNKNOWN
from anisoscope.kinds.plates.causes import FIELD_TITLES
from anisoscope.kinds.plates.decision import MEASURE_LOBE, NONE_NAMED
from anisoscope.kinds.plates.kind import RULE as PLATE_RULE
from anisoscope.kinds.prints.decision import NONE_EXCLUDED, NOT_JUDGED
from anisoscope.kinds.prints.missing_ink import MISSING_TITLE
from anisoscope.kinds.registry import kind_named
from anisoscope.kinds.wafers.causes import DEEP_PASS, SHALLOW_PASS, SHIFTED, wafer_causes
from anisoscope.profiles.etching import Etched
from anisoscope.quality import nelson
from anisoscope.report import rule
from anisoscope.report.conclusion import BULGE, OUTCOMES, SINK
from anisoscope.report.inspection_page import INVALID_RULE, MEANING

ROOT = Path(__file__).resolve().parents[1]
LOCALE = ROOT / "inspect" / "base" / "locale"
LANGUAGES = ("de", "da")
TEMPLATES = (
    "inspect/report/templates/inspection.html",
    "inspect/report/templates/inspection_surface_map.html",
    "inspect/report/templates/history.html",
    "inspect/report/templates/compared.html",
    "inspect/kinds/prints/templates/inspection_print_colours.html",
    *(
        f"inspect/console/templates/{name}.html"
        for name in ("accounts", "audit", "base", "live", "login", "picture", "problem", "station")
    ),
    *(
        f"inspect/console/templates/fleet{name}.html"
        for name in ("", "_charts", "_inspection", "_maps", "_parts", "_view")
    ),
)
CALLS = (
    *("inspect/report", "inspect/cli/inspect", "inspect/cli/rig", "inspect/cli/demo", "inspect/operations"),
    *("inspect/cli/history", "inspect/kinds", "inspect/console", "inspect/live_view"),
)
"""Folders whose calls of `message` are messages."""
ERRORS = {"MeasurementError", "CalibrationError", "RegistrationError"}
SENTENCES = {
    "inspect/base/notation.py": ("quantity_name",),
    "inspect/report/conclusion.py": (
        "_of_verdict",
        "_undecided",
        "_too_uncertain",
        "_passed",
        "blind_to",
        "surface_finding",
        "_contrast_finding",
        "_form_finding",
        "_finding",
    ),
    "inspect/decision/certificate.py": {"message"},
    "inspect/decision/reference_parts.py": ("lacking", "_waiting", "refused_text", "words", "of_the_lot"),
    "inspect/decision/design_vs_map.py": ("compare",),
    "inspect/decision/exclusion.py": ("excluded_text", "open_text"),
    "inspect/decision/surface_exclusion.py": ("lacking_text", "remedy_text"),
    "inspect/decision/decision.py": (
        "_combine",
        "_blind",
        "_of_tolerance",
        "_of_length",
        "_of_form",
        "_limit_of",
    ),
    "inspect/diagnosis/part_diagnosis.py": ("explain", "_summary"),
    "inspect/imaging/pose_radiance.py": ERRORS,
    "inspect/imaging/quality_gates.py": ERRORS,
    "inspect/imaging/ridge_waves.py": ERRORS,
    "inspect/imaging/views.py": ERRORS,
    "inspect/imaging/registration/placement.py": ERRORS,
    "inspect/imaging/deviation_map.py": ERRORS,
    "inspect/imaging/predicted_cells.py": ("predicted_cells",),
    "inspect/imaging/height_map_place.py": {"match_map", "note", "words", "RegistrationError"},
    "inspect/diagnosis/discriminating_poses.py": ("advice_for", "further_pose", "_nothing"),
    "inspect/commissioning/findings.py": (
        *("tilt_findings", "light_finding", "azimuth_finding", "_sense", "_zero", "_fixture_zero"),
        *("_lean_zero", "_seat", "_steps", "_centre", "_pixel"),
    ),
    "inspect/commissioning/commissioning.py": ("_notes",),
    "inspect/kinds/surface.py": ("predicted_cells", "comparable_means", "summary", "_unjudged_form"),
    "inspect/kinds/surface_reference.py": ("unlike_text",),
    "inspect/kinds/wafers/kind.py": ("predicted_cells", "comparable_means", "_with_local"),
    "inspect/kinds/plates/kind.py": ("finding", "code_lines", "grade_lines", "conclude"),
    "inspect/kinds/plates/decision.py": ("_verdict", "_of_fields", "_together", "contrast_text"),
    "inspect/kinds/plates/field_judgement.py": ("fields_text", "places_text", "_field_text"),
    "inspect/kinds/plates/measurement.py": ERRORS,
    "inspect/kinds/prints/kind.py": ("finding", "diagnose"),
    "inspect/kinds/prints/decision.py": ("_together", "_combine", "_of_area"),
    "inspect/kinds/prints/quantities.py": ("sentence", "colour"),
    "inspect/kinds/prints/missing_ink.py": ("reason",),
    "inspect/kinds/prints/report.py": ("print_rule",),
    "inspect/quality/control.py": ("verdict", "_trouble", "capable_words", "_notes"),
    "inspect/quality/capability.py": ("specification", "_one"),
    "inspect/cli/inspect/batch_operator.py": ("place", "serial_of", "trouble", "_part"),
    "inspect/cli/rig/motion.py": {"confirm"},
    "inspect/inspection/run.py": {"advance", "old_pictures"},
    "inspect/diagnosis/signatures.py": {"advance"},
    "rig/acquisition/runner.py": {"_report"},
    "rig/stages/manual.py": {"_prompt"},
    "rig/stages/motion.py": {"message"},
    "rig/lights/manual.py": {"_prompt"},
}
"""File -> names of definitions whose texts, or of functions whose first argument, are messages."""
FURTHER = (
    *("lamp level", "stray light", "focus", "angle", "not taught (anisoscope calibrate fixture)"),
    *("the markers are not seen", "the arm is tilted", "focus first: blur looks like stray light"),
    "the markers disagree by {residual} px",
    *("marker {names} is left out", "marker {marker} is dirty or in shadow: clean it"),
    *("PASS", "FAIL", "INCONCLUSIVE", "INVALID"),
    *("ln ratio {contrast}", "Michelson contrast {contrast}", "difference {contrast}"),
    *("company", "drawing", "lot", "cavity", "operator", "station", "reviewed by", "date, signature"),
    *("{request} and press Enter:", "stage", "tilt axis", "sample", "dark", "flat"),
    *("stray", "linearity", "rotation", "fixture", "at least {size}", "at most {size}"),
    *("across the ridges", "along the ridges", "contrast", "from [°]", "to [°]", "tilt [°]", "measured"),
    *("predicted", "deviation", "tolerance", "at [°]", "tilts [°]", "the same stage angle at two tilts"),
    *("as predicted", "see the reasons above", "{stage}° / {other}°, tilt {tilt}°"),
    *(
        "ln ratio of {letter} {contrast}",
        "{one} / {other} at {stage}°, tilt {tilt}°",
        "{one}, perhaps {other}",
    ),
    *("the height map", "the ideal design"),
    *(
        "check",
        "value",
        "limit",
        "unit",
        "outcome",
        "WARN",
        "SKIPPED",
        "set by hand",
        "camera",
        "light",
        "tilt",
        "rig",
    ),
    *(
        "id",
        "time",
        "serial",
        "why",
        "disposition",
        "software",
        "folder",
        "inspection",
        "recipe",
        "product",
        "seal",
    ),
    *("accept", "reject", "rework", "remeasure", "hold", "white reference", "convention", "model"),
    *(
        "its record is the one in the history",
        "gone",
        "as the inspection wrote it",
        "made again from the frames",
    ),
    *("found", "not identifiable", "not measured", "{count} more things differ", "file {name}"),
    "recipe, rig and calibrations in detail are not compared: {error}",
    *("roughness along x", "roughness along y", "ln of roughness at 90° over 0°", "level of the ink"),
    *("ln of roughness at 135° over 45°", "shift of u′v′", "tilt of the flakes", "lobe and level"),
    *("change of tilt across the region", "the deviating area", "all channels together", "nominal", "off by"),
    "level too high (ink brighter or denser, or lamp and flat not as they were), relative excess",
    *("dots too large: more ink than there should be, relative", "roughness of the lobe, relative change"),
    "brushed print: roughness at {across}° over {along}°, relative excess",
    "flakes shingled, or sheet not flat in its seat: leans toward {toward}° by",
    *("film of the flakes: spectra shifted by", "share of {name} in the ink", "spots, share of the area"),
    *("form of the lobe, 0 as in the recipe, 1 the other distribution", MISSING_TITLE),
    *("curled sheet, change of tilt across the region", "like the {count} golden prints", NOT_JUDGED),
    *("missing", "merged", "wrong direction", "worn", "filled", "unlike any known defect", PLATE_RULE),
    *FIELD_TITLES.values(),
    *("cell contrast", "minimum reflectance", "cell modulation", "fixed pattern damage", "not read"),
    *("axial non-uniformity", "grid non-uniformity", "unused error correction", "row, column", "class"),
    *("ln ratio", "looks like", "fields that deviate", "The fields are at {places}"),
    *("idle", "running", "fault", "off", "no sign", "capable", "barely capable", "not capable"),
    *(
        "1 pattern",
        "{count} patterns",
        "1 jump",
        "{count} jumps",
        "1 value",
        "{count} values",
        "the selection",
    ),
    "a control chart needs at least {least} measured values, not {count}",
    "no two measured values of the baseline follow each other: there is no moving range",
    "all values of the baseline are the same: there is nothing to draw limits from; is the number rounded?",
    *("missing ridge", "flank", "scratch", "spot", "patch", "{count} golden parts", "1 golden part"),
    *("burr", "filled groove", "dust", "fibre", "weld line", TEXTURE, UNKNOWN, SINK, BULGE),
    *("ridge angle +{size}", "ridge angle −{size}", "height loss {size}", "edges worn to {size}"),
    *("roughness along the ridges +{size}", "roughness across the ridges +{size}"),
    *("etched too deep by {size}", "etched too shallow by {size}"),
    *("features too wide by {size}", "features too narrow by {size}"),
    *("flakes less flat by {size}", "flakes flatter by {size}", "brushed by {size}", "flakes lean by {size}"),
    *("ink missing {size}", "film thicker by {size}", "film thinner by {size}", "{name} in the ink {size}"),
    *("field ridge angle +{size}", "field ridge angle −{size}", "field height loss {size}"),
    *("field worn to {size}", "field bare on {size}", "{defect} (up to {size} at row {row} column {column})"),
    *("every field ridge angle +{size}", "every field ridge angle −{size}", "every field height loss {size}"),
    *("every field worn to {size}", "every field bare on {size}"),
    *(NONE_NAMED, MEASURE_LOBE, NONE_EXCLUDED),
    *("photograph more poses", "photograph further tilts", "{defect} (any size)", "{defect} (up to {size})"),
)
"""Names that reach the page or the console from data."""
HEADER = (
    "# Messages of the operator's path; `python tools/messages.py` brings them up to date and compiles them."
)
_IN_TEMPLATE = re.compile(r"""_\((?:"((?:[^"\\]|\\.)*)"|'((?:[^'\\]|\\.)*)')""")
_PLACE = re.compile(r"\{(\w+)\}")


def found_messages(root: Path = ROOT) -> dict[str, str]:
    """All messages, each with the file that it comes from."""
    found: dict[str, str] = {}
    for name in TEMPLATES:
        for texts in _IN_TEMPLATE.findall((root / name).read_text(encoding="utf-8")):
            found.setdefault("".join(texts), name)
    for folder in CALLS:
        for path in sorted((root / folder).rglob("*.py")):
            for text in _texts(path, {"message"}):
                found.setdefault(text, str(path.relative_to(root)))
    for name, definitions in SENTENCES.items():
        for text in _texts(root / name, set(definitions)):
            found.setdefault(text.rstrip(), name)
    for text in (*_tables(), *FURTHER):
        found.setdefault(text, "tables")
    return found


def _texts(path: Path, names: set[str]) -> Iterator[str]:
    """Texts of the definitions of these names, and first arguments of calls of functions of these names."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef) and node.name in names:
            for statement in node.body[1 if ast.get_docstring(node) else 0 :]:
                yield from _sentences(statement)
        elif isinstance(node, ast.Call) and _name(node.func) in names and node.args:
            yield from filter(None, [_text(node.args[0])])


def _sentences(statement: ast.AST) -> Iterator[str]:
    """Texts of a statement with a blank in them."""
    inner = {
        id(part) for node in ast.walk(statement) if isinstance(node, ast.JoinedStr) for part in node.values
    }
    for node in ast.walk(statement):
        if id(node) not in inner and isinstance(node, (ast.JoinedStr, ast.Constant)):
            text = _text(node)
            if text is not None and " " in text and re.search(r"[a-z]{3}", _PLACE.sub("", text)):
                yield text


def _text(node: ast.expr) -> str | None:
    """A text as a message: places of an f-string get the last name in their expression."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if not isinstance(node, ast.JoinedStr):
        return None
    seen: dict[str, str] = {}
    parts: list[str] = []
    for part in node.values:
        if isinstance(part, ast.Constant):
            parts.append(str(part.value))
        elif isinstance(part, ast.FormattedValue):
            expression = ast.unparse(part.value)
            name = (
                re.findall(r"[a-z_]\w*", re.sub(r"'[^']*'", "", expression), re.IGNORECASE)[-1]
                .lower()
                .strip("_")
            )
            while seen.setdefault(name, expression) != expression:
                name += "_"
            parts.append("{" + name + "}")
    return "".join(parts)


def _name(function: ast.expr) -> str:
    return (
        function.attr
        if isinstance(function, ast.Attribute)
        else function.id
        if isinstance(function, ast.Name)
        else ""
    )


def _tables() -> Iterator[str]:
    """Texts of the tables of the package."""
    yield from (*OUTCOMES.values(), *MEANING.values(), INVALID_RULE, *rule.CONTRASTS.values())
    for names, _ in STEPS:
        yield from (words for _, words in names)
    yield from (*NUMBER_WORDS.values(), " and ".join(f"{tilt:g}°" for tilt in TILTS_DEG))
    yield from (*nelson.RULES.values(), *nelson.MEANING.values())
    yield from (
        rule.AREA_OUTSIDE,
        rule.AREA_NEAR,
        rule.FORM_OUTSIDE,
        rule.FORM_NEAR,
        rule.EXCLUDED_RULE,
        rule.OPEN_CRITERION,
    )
    for name in ("ridges", "wafers", "prints", "plates"):
        for key, words in kind_named(name).cause_words.items():
            yield key.replace("-", " ")
            yield from filter(None, (words.more, words.less, words.either, words.action, words.region))
    one_pass = Etched(np.zeros((1, 1), np.uint8), (0.1,), 1.0)
    for title in (DEEP_PASS, SHALLOW_PASS, *SHIFTED.values()):
        yield from (title, bare_title(title))
    for cause in (*all_causes(10.0), *wafer_causes(one_pass)):
        yield from dict.fromkeys((cause.title, bare_title(cause.title)))


def catalogue(language: str) -> Catalog:
    """The catalogue of a language."""
    with (LOCALE / language / "LC_MESSAGES" / "anisoscope.po").open("rb") as file:
        return read_po(file, locale=language)


def compiled(found: Catalog) -> bytes:
    """A catalogue as gettext reads it."""
    stream = io.BytesIO()
    write_mo(stream, found)
    return stream.getvalue()


def update(language: str, messages: dict[str, str]) -> int:
    """Bring a catalogue up to date and compile it; returns how many messages have no translation."""
    folder = LOCALE / language / "LC_MESSAGES"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "anisoscope.po"
    known = {one.id: one.string for one in catalogue(language) if one.id} if path.is_file() else {}
    found = Catalog(locale=language, project="anisoscope", version="", header_comment=HEADER, fuzzy=False)
    found.msgid_bugs_address = found.last_translator = found.language_team = ""
    found.creation_date = found.revision_date = datetime(2026, 1, 1, tzinfo=UTC)  # no change without a change
    for text, source in messages.items():
        found.add(text, known.get(text, ""), auto_comments=[source])
    with path.open("wb") as file:
        write_po(file, found, width=120, omit_header=False)
    path.with_suffix(".mo").write_bytes(compiled(found))
    return sum(not one.string for one in found if one.id)


if __name__ == "__main__":
    everything = found_messages()
    missing = {language: update(language, everything) for language in LANGUAGES}
    print(f"{len(everything)} messages; without translation: {missing}")  # noqa: T201
    sys.exit(any(missing.values()))

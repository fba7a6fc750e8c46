"""Certificates of false alarms: what verdicts of good parts prove, whatever their distribution."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.base.json_fields import in_json
from anisoscope.base.language import message
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.base.significance import proportion_interval
from anisoscope.decision.reference_parts import golden_path
from anisoscope.record.schema import sha256_of

CERTIFICATE = "false alarm certificate"
"""Role of its file in an inspection."""
_ENDING = ".certificate.json"


@dataclass(frozen=True)
class FalseAlarmCertificate:
    """Proof about false alarms by the verdicts of good parts that are not golden ones.

    Free of any distribution: the rate after C. J. Clopper and E. S. Pearson, Biometrika 26 (1934) 404; the level by
    order statistics after S. S. Wilks, Annals of Mathematical Statistics 12 (1941) 91.

    Attributes:
        parts: good parts with a verdict.
        alarms: of these FAIL.
        undecided: of these INCONCLUSIVE.
        highest: upper limit of the rate of false alarms with the confidence.
        confidence: one-sided.
        wanted: largest rate that is to be certified.
        needed: good parts that certify it if none fails.
        stated: the model's own statement: the level of the recipe's test of all contrasts together.
        level: largest level of that test that holds the wanted rate with the confidence, whatever the distribution;
            None with too few parts or without p values.
    """

    parts: int
    alarms: int
    undecided: int
    highest: float
    confidence: float
    wanted: float
    needed: int
    stated: float | None
    level: float | None

    @property
    @in_json()
    def certified(self) -> bool:
        """The wanted rate is proven."""
        return self.highest <= self.wanted

    @property
    @in_json()
    def verdict(self) -> str:
        """The certificate in a sentence."""
        text = (
            f"at most {self.highest:.2%} false alarms with {self.confidence:.0%} confidence after {self.parts} good "
            f"parts, {self.alarms} of which failed"
        )
        if self.certified:
            return f"certified: {text} (wanted: {self.wanted:.2%})"
        return f"not certified: {text}; {self.wanted:.2%} takes {self.needed} good parts of which none fails"


def certificate(
    verdicts: Sequence[str],
    p_values: Sequence[float | None],
    wanted: float = 0.01,
    confidence: float = 0.95,
    stated: float | None = None,
) -> FalseAlarmCertificate:
    """Limit of the rate of false alarms from the verdicts of different good parts.

    Args:
        verdicts: PASS, INCONCLUSIVE or FAIL of every part.
        p_values: of all contrasts together, of every part; None where it has none.
        wanted: largest rate.
        confidence: one-sided.
        stated: level of the recipe's test.

    Raises:
        UsageError: no part, or a rate or confidence that is none.
    """
    from scipy.special import betainc  # noqa: PLC0415 - start-up time

    if not verdicts:
        raise UsageError("no good part with a verdict is left: nothing can be certified")
    if not (0.0 < wanted < 1.0 and 0.5 <= confidence < 1.0):
        raise UsageError(
            f"the rate lies between 0 and 1 and the confidence between 0.5 and 1, not at {wanted:g} and {confidence:g}"
        )
    count, alarms = len(verdicts), sum(one == "FAIL" for one in verdicts)
    highest = proportion_interval(alarms, count, 2.0 * confidence - 1.0)[1]
    needed = math.ceil(math.log1p(-confidence) / math.log1p(-wanted))
    known = sorted(p for p in p_values if p is not None)
    places = [r for r in range(1, len(known) + 1) if betainc(r, len(known) - r + 1, wanted) >= confidence]
    level = known[places[-1] - 1] if places and len(known) == count else None
    undecided = sum(one == "INCONCLUSIVE" for one in verdicts)
    return FalseAlarmCertificate(
        count, alarms, undecided, highest, confidence, wanted, needed, stated, level
    )  # fmt: skip


class StoredCertificate(BaseModel):
    """A certificate in a file next to its recipe: it holds for this recipe and these golden parts alone.

    Attributes:
        recipe: SHA-256 of the recipe file.
        golden: SHA-256 of the golden parts; None where there are none.
        certified_on: date, ISO 8601.
        serials: the good parts with a verdict.
        alarms: of these FAIL.
        highest: upper limit of the rate of false alarms.
        confidence: one-sided.
        stated: level of the recipe's test of all contrasts together, or None.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    recipe: str
    golden: str | None
    certified_on: str
    serials: tuple[str, ...]
    alarms: Annotated[int, Field(ge=0)]
    highest: Annotated[float, Field(gt=0.0, le=1.0)]
    confidence: Annotated[float, Field(gt=0.0, lt=1.0)]
    stated: float | None

    @classmethod
    def of(
        cls, recipe_path: Path, found: FalseAlarmCertificate, serials: Sequence[str], day: str
    ) -> "StoredCertificate":
        """Certificate of a recipe and its present golden parts."""
        return cls(
            recipe=sha256_of(recipe_path),
            golden=_golden_hash(recipe_path),
            certified_on=day,
            serials=tuple(serials),
            alarms=found.alarms,
            highest=found.highest,
            confidence=found.confidence,
            stated=found.stated,
        )

    @classmethod
    def read(cls, path: Path) -> "StoredCertificate":
        """The certificate in a file.

        Raises:
            CalibrationError: the file is missing or damaged.
        """
        try:
            return cls.model_validate_json(bounded_bytes(path))
        except (OSError, ValidationError) as problem:
            reason = str(problem).splitlines()[0]
            raise CalibrationError(
                f"the certificate of false alarms in {path} cannot be read: {reason}: certify again (golden certify "
                "--for-reports), or delete the file"
            ) from problem

    def write(self, path: Path) -> None:
        """Write it, all or nothing.

        Raises:
            RecordError: the folder cannot be written.
        """
        write_text(path, self.model_dump_json(indent=2, by_alias=True))

    @property
    def text(self) -> str:
        """The certificate in a sentence of the report."""
        proven = message(
            "at most {highest} with {confidence} confidence, whatever the distribution ({alarms} of {count} good parts "
            "failed; {day})",
            highest=f"{self.highest:.2%}",
            confidence=f"{self.confidence:.0%}",
            count=len(self.serials),
            alarms=self.alarms,
            day=self.certified_on,
        )
        if self.stated is None:
            return proven
        return message("{proven}; the model states {stated}", proven=proven, stated=f"{self.stated:.2%}")


def certificate_path(recipe_path: Path) -> Path:
    """Path of the certificate of a recipe: ``NAME.certificate.json`` next to it."""
    return recipe_path.with_name(recipe_path.stem + _ENDING)


def valid_certificate(recipe_path: Path) -> Path | None:
    """The file of the certificate, if it was made for this recipe and these golden parts.

    Raises:
        CalibrationError: the file is damaged.
    """
    path = certificate_path(recipe_path)
    if not path.is_file():
        return None
    found = StoredCertificate.read(path)
    same = (found.recipe, found.golden) == (sha256_of(recipe_path), _golden_hash(recipe_path))
    return path if same else None


def certificate_of(names: Sequence[str], folder: Path) -> StoredCertificate | None:
    """The certificate among the files of an inspection, or None.

    Args:
        names: of the files, relative to the folder.
        folder: of the inspection.

    Raises:
        CalibrationError: the file is missing or damaged.
    """
    name = next((one for one in names if one.endswith(_ENDING)), None)
    return None if name is None else StoredCertificate.read(folder / name)


def _golden_hash(recipe_path: Path) -> str | None:
    path = golden_path(recipe_path)
    return sha256_of(path) if path.is_file() else None

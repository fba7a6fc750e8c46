"""The four verdicts."""

from enum import StrEnum


class Verdict(StrEnum):
    """Verdict on a part."""

    PASS = "PASS"
    FAIL = "FAIL"
    INCONCLUSIVE = "INCONCLUSIVE"
    INVALID = "INVALID"

    @property
    def exit_code(self) -> int:
        """Exit code of ``anisoscope inspect``."""
        return {"PASS": 0, "FAIL": 1, "INCONCLUSIVE": 2, "INVALID": 3}[self.value]

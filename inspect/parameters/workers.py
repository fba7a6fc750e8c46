"""Processes or cluster that share the work of a sweep (`anisoscope.study.sweep`)."""

from dataclasses import dataclass

from anisoscope.base.errors import UsageError


@dataclass(frozen=True)
class Workers:
    """Processes or cluster of a sweep.

    Attributes:
        jobs: processes on this machine; 1 is this process, None one for every core.
        scheduler: address of a Dask scheduler (tcp://host:8786) that computes instead.

    Raises:
        UsageError: fewer than one process.
    """

    jobs: int | None = 1
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise UsageError(f"--jobs takes 1 or more, not {self.jobs}")

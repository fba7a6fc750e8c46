"""How the mould insert of a plate is made."""

from dataclasses import dataclass

from anisoscope.base.errors import UsageError


@dataclass(frozen=True)
class Manufacture:
    """What is written for the making of an insert.

    Attributes:
        stl: write part and insert as closed STL bodies in mm, too.
        base_mm: thickness of these bodies below their surface in mm.
        npz: write the height maps as npz, too.
        path: write the finishing cuts of the insert: two tables in mm, and G-code.
        tool_half_angle_deg: half angle of the engraving cone in degrees, at most the draft.
        feed: feed of a cut in mm/min.

    Raises:
        UsageError: a base without thickness, or a tool that does not move.
    """

    stl: bool = False
    base_mm: float = 1.0
    npz: bool = False
    path: bool = False
    tool_half_angle_deg: float = 10.0
    feed: float = 100.0

    def __post_init__(self) -> None:
        if self.stl and not self.base_mm > 0.0:
            raise UsageError(f"--base-mm must be a positive number of mm, not {self.base_mm:g}")
        if self.path and not self.feed > 0.0:
            raise UsageError(f"--feed must be a positive number of mm/min, not {self.feed:g}")

    def names(self) -> list[str]:
        """Files that are written."""
        found = ["part.x3p", "insert.x3p"]
        found += ["part.npz", "insert.npz"] if self.npz else []
        found += ["part.stl", "insert.stl"] if self.stl else []
        return found + (["insert-passes.csv", "insert-fields.csv", "insert.nc"] if self.path else [])

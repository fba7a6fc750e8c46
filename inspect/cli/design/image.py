"""Images that a design is made from, and pictures of half vectors."""

import io
from pathlib import Path
from typing import TYPE_CHECKING

from anisoscope.base.errors import UsageError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from anisoscope.base.arrays import FloatArray


def read_image(path: Path, *, colour: bool = False, others: str = "") -> "npt.NDArray[np.uint8]":
    """An image as (rows, cols) grey values, or as (rows, cols, 3) blue, green and red; 0 to 255.

    Args:
        path: a PNG, TIFF or JPEG.
        colour: three channels.
        others: what else the option takes, for the message.

    Raises:
        UsageError: the file cannot be read, or is none.
    """
    import cv2
    import numpy as np

    try:
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); check the path") from None
    found = cv2.imdecode(data, cv2.IMREAD_COLOR if colour else cv2.IMREAD_GRAYSCALE) if data.size else None
    if found is None:
        raise UsageError(f"{path}: not a picture; give a PNG, TIFF or JPEG{others}")
    return np.asarray(found, dtype=np.uint8)


def draw_panels(panels: "list[tuple[FloatArray, str, str, float, float]]", reach: float, path: Path) -> None:
    """Draw (values, title, colours, low, top) of half vectors side by side into a PNG."""
    from anisoscope.base.atomic_write import write_bytes
    from anisoscope.report.figures import new_figure

    with new_figure(3.4 * len(panels), 3.2) as (figure, axes):
        axes.remove()
        for panel, (values, title, colours, low, top) in zip(
            figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
        ):
            shown = panel.imshow(
                values,
                origin="lower",
                cmap=colours,
                vmin=low,
                vmax=top,
                extent=(-reach, reach, -reach, reach),
            )
            if values.ndim == 2:
                figure.colorbar(shown, ax=panel, shrink=0.8)
            panel.set_title(title, fontsize=9)
            panel.set_xlabel("h_x [1]")
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    write_bytes(path, stream.getvalue())


def check_target(path: Path | None, ending: str, option: str) -> None:
    """Refuse a file to write with another ending, or in no folder.

    Raises:
        UsageError: so.
    """
    if path is not None and path.suffix.lower() != ending:
        raise UsageError(f"{option} writes *{ending}, not {path.name}")
    if path is not None and not path.parent.is_dir():
        raise UsageError(f"{path}: there is no folder {path.parent}; make it first")

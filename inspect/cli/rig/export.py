"""``anisoscope rig export``: the frames of an inspection or a scan as one file for other programs."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import message
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, Overwrite, check_new


def export(
    folder: Annotated[Path, Parameter(help="Folder of an inspection or a scan.")],
    /,
    *,
    out: Annotated[Path, Parameter(help="File to write (.nxs): NeXus, that is HDF5.")],
    overwrite: Overwrite = False,
    json_: Json = False,
) -> int:
    """Write all frames of an inspection or a scan to a NeXus file, with angles, exposures and their units.

    That of a scan holds the table of reflectances as well.

    Examples:
        anisoscope rig export inspections/T-1 --out T-1.nxs
    """
    from anisoscope.base.csv_table import read_table
    from anisoscope.bsdf.directions_table import COLUMNS, OPTIONAL
    from anisoscope.inspection.reflectance_scan import TABLE
    from anisoscope.rig.acquisition.nexus import write_nexus

    if out.suffix.lower() not in {".nxs", ".h5", ".hdf5"}:
        raise UsageError(f"--out {out}: the file is NeXus; name it .nxs")
    check_new((out,), overwrite=overwrite)
    reflectance = None
    if (folder / TABLE).is_file():
        table = read_table(folder / TABLE, (COLUMNS,), OPTIONAL)
        reflectance = {name: table.column(name) for name in table.columns}
    count = write_nexus(folder, out, reflectance)
    if json_:
        print_json({"file": str(out), "frames": count})
    else:
        print(message("{count} frames in {path}", count=count, path=str(out)))  # noqa: T201
    return 0

"""Five-megapixel frames on disk to a sealed record, and to the report, in a running process as in a batch.

Three poses of two frames, the first pose once more, two dark frames, judged against a height map with a 3-D view. The
frames are those of the virtual rig. Copying and hashing them belongs to an inspection; decoding them is stated alone.
"""

import shutil
import tomllib

import pytest
import tomli_w

from anisoscope.base.progress import silent
from anisoscope.calibration.pictures import take_flat
from anisoscope.inspection.replay import inspect_frames
from anisoscope.inspection.run import Methods, inspect_part
from anisoscope.operations.demo.ridges import SCENE
from anisoscope.report.inspection_page import Sections
from anisoscope.rig.frame import read_frame
from anisoscope.rig.framefolder import write_frame_folder

pytestmark = pytest.mark.benchmark
SENSOR = {"rows": 2048, "cols": 2448}
PIXEL_UM = 2.0


def one_line(record, *_):
    return record.verdict


NO_REPORT = Methods(start_renderer=lambda _: None, sections=lambda *_: Sections(), page=one_line)


def changed(path, change):
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    change(table)
    path.write_text(tomli_w.dumps(table), encoding="utf-8")


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """Folder of the demo with a larger sensor, and the folder of the frames of its good part."""
    folder = SCENE.lay_out(tmp_path_factory.mktemp("demo"), 1, silent)
    for name in ("good", "white-tile"):
        place = folder / "bench" / name
        changed(place / "bench.toml", lambda t: t.update(sensor=SENSOR, optics={"pixel_um": PIXEL_UM}))
        changed(place / "rig.toml", lambda t: t["camera"].update(pixel_um=PIXEL_UM))
    changed(folder / "recipe.toml", lambda t: t["acquisition"].update(frames_per_pose=2, dark_frames=2))
    rig = folder / "bench" / "white-tile" / "rig.toml"
    take_flat(rig, folder / "flat.tif", exposure_s=0.006, frames=8, reflectance=0.99)
    rig = folder / "bench" / "good" / "rig.toml"
    taken = inspect_part(folder / "recipe.toml", rig, "A1", folder / "out", methods=NO_REPORT)
    shots = [read_frame(taken.folder / entry.name) for entry in taken.record.frames]
    write_frame_folder(folder / "frames", shots, [entry.again for entry in taken.record.frames])
    return folder, folder / "frames"


def test_frames_on_disk_to_record_and_report(bench, frames, tmp_path):
    folder, taken = frames
    rig, pictures = folder / "bench" / "good" / "rig.toml", sorted(taken.glob("*.tif"))

    def judged(methods):
        def work():
            shutil.rmtree(tmp_path / "out", ignore_errors=True)
            return inspect_frames(
                taken, folder / "recipe.toml", "A1", tmp_path / "out", rig_path=rig, methods=methods
            )

        return work

    found = bench.compare(
        f"{len(pictures)} frames of {SENSOR['cols']} × {SENSOR['rows']} on disk",
        {
            "verdict and sealed record": judged(NO_REPORT),
            "verdict, report and sealed record": judged(None),
            "decoding of the frames": lambda: [read_frame(path) for path in pictures],
        },
    )
    both = [found[label].result.record.verdict for label in list(found.timings)[:2]]
    bench.note(f"verdicts {', '.join(both)}; a batch writes the report while the next part is inspected")
    assert both[0] == both[1]

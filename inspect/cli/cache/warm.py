"""``anisoscope warm``: compile all kernels before the first measurement.

Every job runs public functions on a small input, with the argument types that commands use: numba compiles a kernel for
each of them, and keeps the result next to the source file or in its own cache folder.
"""

import os
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.cache import read_sources
from anisoscope.base.plugins import installed
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.progress import progress
from anisoscope.cli.tables import console

if TYPE_CHECKING:
    from anisoscope.profiles.heightmap import HeightMap


def warm(
    *,
    demo: Annotated[bool, Parameter(negative="", help="Only the kernels of `anisoscope demo`.")] = False,
    json_: Json = False,
) -> int:
    """Compile the kernels of all models for this machine, once; later commands then start without this delay.

    About a minute on two cores after an installation or an update, a few seconds where all are compiled. `make` does it
    at set-up.

    Examples:
        anisoscope warm
        anisoscope warm --demo
    """
    start = perf_counter()
    names = [name for name in JOBS if not demo or name in OF_DEMO]
    seconds: dict[str, float] = {}
    if not json_:
        some = " of the demo" if demo else ""
        console().print(f"Compiling kernels{some} for this machine, about a minute; it is done once.")
    context = get_context("spawn")  # a fork would inherit the threads of the progress bar
    with (
        progress("warm", quiet=json_) as advance,
        ProcessPoolExecutor(min(len(names), os.cpu_count() or 1), mp_context=context) as pool,
    ):
        running = {pool.submit(_timed, name): name for name in names}
        for done in as_completed(running):
            seconds[running[done]] = done.result()
            advance(running[done], len(seconds), len(names))
    _read_sources()
    total = perf_counter() - start
    if json_:
        print_json({"jobs": {name: seconds[name] for name in names}, "seconds": total})
    else:
        console().print(f"Kernels are compiled ({total:.0f} s).")
    return 0


def _read_sources() -> None:
    """Parse what keys of the cache are made of: the sources of all commands, of the kinds of parts, and of devices.

    Commands, devices and the program that draws surfaces are named by text, which no import statement says.
    """
    from anisoscope.record.details import GROUP
    from anisoscope.report.surface_view import DRAWS
    from anisoscope.rig.drivers import CAMERAS, LIGHTS, STAGES

    folder = Path(__file__).parent.parent
    sources = [path.relative_to(folder).with_suffix("").parts for path in folder.rglob("*.py")]
    commands = [".".join(("anisoscope.cli", *parts)).removesuffix(".__init__") for parts in sources]
    plugins = [
        entry.module for group in (GROUP, STAGES, CAMERAS, LIGHTS) for entry in installed(group).values()
    ]
    read_sources(*commands, DRAWS, *(name for name in plugins if name.startswith("anisoscope.")))


def _timed(name: str) -> float:
    start = perf_counter()
    JOBS[name]()
    return perf_counter() - start


def _small_map() -> "HeightMap":
    import numpy as np

    from anisoscope.parameters.ridges import RidgeDesign
    from anisoscope.profiles.ideal import add_facet_roughness, ridges

    smooth = ridges(RidgeDesign(50.0, 10.0), (100, 200), 2.0)
    return add_facet_roughness(smooth, 0.0, 0.03, 8.0, np.random.default_rng(1))


def _measured_map() -> None:
    from anisoscope.profiles.metrology.ridges import measure_ridges

    measure_ridges(_small_map())


def _predicted_map() -> None:
    from anisoscope.parameters.geometry import Convention
    from anisoscope.parameters.material import Material
    from anisoscope.prediction.predict import predict_height_map
    from anisoscope.sim.light.geometry import pose_grid

    # poses with shadows: without them the kernels of the horizon are not called
    poses = pose_grid((0.0, 90.0, 180.0), (-40.0,))
    predict_height_map(_small_map(), Material(), poses, Convention(), 50.0)


def _rendered_map() -> None:
    import numpy as np

    from anisoscope.parameters.material import Material
    from anisoscope.sim.light.relief import Relief, radiance_maps, radiance_of_cells

    up, aslant = np.array([[0.0, 0.0, 1.0]]), np.array([[0.8, 0.0, 0.6]])
    list(radiance_maps(Relief(_small_map(), 50.0), aslant, up, Material()))
    radiance_of_cells(Relief(_small_map(), 50.0), aslant, up, Material(), 12.5)


def _traced_scene() -> None:
    import numpy as np

    from anisoscope.sim.pathtracer.plastic import Plastic
    from anisoscope.sim.pathtracer.tracer import PathTracer

    up = np.array([0.0, 0.0, 1.0])
    PathTracer(_small_map(), Plastic(0.1, 0.1, 0.2), pitch_um=50.0, paths=64).radiance(up, up)


def _wave() -> None:
    import numpy as np

    from anisoscope.parameters.geometry import Convention
    from anisoscope.parameters.material import Material
    from anisoscope.prediction.optics_selection import OpticsRequest, Rig, predict_with_optics
    from anisoscope.prediction.predict import predict_height_map
    from anisoscope.profiles.etching import Etched
    from anisoscope.profiles.heightmap import HeightMap
    from anisoscope.sim.light.geometry import pose_grid
    from anisoscope.sim.light.wave.orders import Orders

    checkerboard = np.where(np.indices((160, 160)).sum(axis=0) // 20 % 2, 0.125, 0.0)
    surface, isotropic = HeightMap(checkerboard, 0.1, 0.1, {}), Material(0.1, 0.1)
    poses, convention = pose_grid((0.0,), (0.0,)), Convention()
    predict_with_optics(
        surface,
        lambda _: predict_height_map(surface, isotropic, poses, convention),
        Rig(isotropic, poses, convention),
        OpticsRequest("wave"),
        None,
    )
    upright = np.array([[0.0, 0.0, 1.0]])
    Orders.of(Etched.of(surface)).seen(
        np.array([0.0, 0.125]), upright, upright, np.array([0.5]), (0.05, 0.05)
    )


def _dots() -> None:
    import numpy as np

    from anisoscope.sim.design.dot import DotTask
    from anisoscope.sim.design.refine import Bench, Polish
    from anisoscope.sim.light.wave.sampling import Widths

    widths = Widths((2.0, 3.0), (0.5, 0.5))
    bench = Bench(DotTask(widths, widths, (0.0, -0.125), dot_um=24.0, coherence_um=8.0))
    Polish(bench, bench.task.draw(np.random.default_rng(1))).step()


def _inks() -> None:
    from dataclasses import replace

    from anisoscope.sim.light.colour.illuminant import standard
    from anisoscope.sim.light.ink.shading import Light, picture
    from anisoscope.sim.light.ink.shapes import sphere
    from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink

    ink, light = synthetic_ink(SYNTHETIC[0]), Light((0.0, 0.5, 1.0), illuminant=standard("d65"))
    for one in (ink, replace(ink, distribution="beckmann")):  # by series, and by table
        picture(sphere(16, 16), [one], [light])


def _halftones() -> None:
    from typing import get_args

    import numpy as np

    from anisoscope.sim.light.colour.illuminant import standard
    from anisoscope.sim.materials.inks import SYNTHETIC, synthetic_ink
    from anisoscope.sim.proof.halftone import Method, halftone
    from anisoscope.sim.proof.separation import separation

    plan = separation(tuple(map(synthetic_ink, SYNTHETIC)), standard("d65"))
    image = np.random.default_rng(1).integers(0, 256, (16, 16, 3), dtype=np.uint8)
    for method in get_args(Method):
        halftone(image, plan, method)


JOBS: dict[str, Callable[[], None]] = {
    "predictions of height maps": _predicted_map,
    "pictures of height maps": _rendered_map,
    "ridges on height maps": _measured_map,
    "virtual rig": _traced_scene,
    "wave optics": _wave,
    "halftones": _halftones,
    "inks": _inks,
    "dots": _dots,
}
"""By what they prepare, the longest first."""
OF_DEMO = ("predictions of height maps", "pictures of height maps", "ridges on height maps", "virtual rig")
"""What the demo with ridges calls."""

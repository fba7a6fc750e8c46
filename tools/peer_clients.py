"""Other people's clients, whose licence keeps them out of the tests, against the simulated devices.

Each gets an environment of its own below a cache folder, made once by pip, and drives a device on a pseudo terminal.
Run it before a release; nothing of the package or its tests imports any of them::

    python tools/peer_clients.py            # all; or the names of some
    python tools/peer_clients.py --write    # and store what they say in docs/evidence/peer-clients.md
"""

import subprocess
import sys
import venv
from dataclasses import dataclass
from pathlib import Path

from platformdirs import user_cache_path

from anisoscope.sim.bench.firmware.axis import RotaryAxis
from anisoscope.sim.bench.firmware.catalogue import Mount, build
from anisoscope.sim.bench.firmware.coolled import CoolLedFirmware
from anisoscope.sim.bench.firmware.device import Firmware
from anisoscope.sim.bench.firmware.fw102c import WheelFirmware
from anisoscope.sim.bench.serve import PtyServer

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "docs" / "evidence" / "peer-clients.md"
TURNED_DEG = 33.0
LIMIT_S = 180


@dataclass(frozen=True)
class Peer:
    """A published client, pinned, and the device that it drives."""

    package: str
    licence: str
    device: str
    model: str


PEERS = {
    "pylablib_k10cr1": Peer("pylablib-lightweight==1.4.3", "GPL-3", "apt", "K10CR1"),
    "apt_device_kdc101": Peer("thorlabs-apt-device==0.3.8", "GPL-3", "apt", "KDC101"),
    "microscope_zaber": Peer("microscope==0.7.0", "GPL-3", "zaber", "X-RSW60A"),
    "microscope_coolled": Peer("microscope==0.7.0", "GPL-3", "coolled", "pE-300"),
    "microscope_fw102c": Peer("microscope==0.7.0", "GPL-3", "fw102c", "FW102C"),
    "hvl_ccb_smc100": Peer("hvl-ccb==0.19.6", "GPL-3", "smc100", "urs75pp"),
}


def interpreter_with(package: str) -> Path:
    """Python of an environment that holds a package; made where there is none yet.

    Raises:
        subprocess.CalledProcessError: pip does not find it.
    """
    folder = user_cache_path("anisoscope") / "peers" / package.replace("==", "-")
    python = folder / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    if not (folder / "complete").exists():
        venv.create(folder, with_pip=True, clear=True)
        subprocess.run(
            [python, "-m", "pip", "install", "--quiet", "pyserial", package, *ALSO.get(package, ())],
            check=True,
        )
        (folder / "complete").touch()
    return python


# What these need and do not require.
ALSO = {"hvl-ccb==0.19.6": ("aenum",), "pylablib-lightweight==1.4.3": ("numba", "pyft232")}


def run(name: str) -> tuple[bool, str]:
    """Let a client drive its device; whether the device then stands where it was sent, and what the client said."""
    peer = PEERS[name]
    python = interpreter_with(peer.package)
    axis = RotaryAxis(time_scale=0.1, start_deg=12.0)
    device = build(peer.device, [Mount(axis)], model=peer.model)
    with PtyServer(device) as server:
        done = subprocess.run(
            [python, HERE / "peers" / f"{name}.py", server.port],
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
    arrived = done.returncode == 0 and _stands(device, axis)
    said = done.stdout if done.returncode == 0 else done.stdout + done.stderr
    return arrived, said.replace(server.port, "PORT").strip()


def _stands(device: Firmware, axis: RotaryAxis) -> bool:
    """Whether the device is where its client was to bring it."""
    if isinstance(device, CoolLedFirmware):
        return b"CSSBSN040" in device.commands and all(lamp.level == 0.0 for lamp in device.lamps.values())
    if isinstance(device, WheelFirmware):
        return device.place == 4
    return abs(axis.position() - TURNED_DEG) < 0.01


def page(results: dict[str, tuple[bool, str]]) -> str:
    """The page of evidence."""
    lines = [
        "# Clients of other people\n",
        "`python tools/peer_clients.py --write` lets published clients drive the simulated devices on a pseudo",
        "terminal: home, then 33° (of lamps B at 40 %, of filters the fourth). Their licence (GPL) keeps",
        "them out of the tests; each has its own environment.",
        "Permissive ones (`zaber-motion`, `thorlabs-apt-protocol`, `pygrbl-streamer`) are in the tests.\n",
    ]
    for name, (arrived, said) in results.items():
        peer = PEERS[name]
        there = {"coolled": "lamp B at 40 %, then dark", "fw102c": "filter 4"}.get(
            peer.device, "stands at 33°"
        )
        verdict = there if arrived else f"not: {there}"
        lines += [f"## {peer.package}, {peer.device} {peer.model}: {verdict}\n", "```", said, "```\n"]
    return "\n".join(lines)


def main() -> int:
    """Run them; 0 if every device stands where it was sent."""
    names = [name for name in sys.argv[1:] if not name.startswith("-")] or list(PEERS)
    results = {}
    for name in names:
        results[name] = run(name)
        arrived, said = results[name]
        sys.stdout.write(
            f"{'ok  ' if arrived else 'FAIL'} {PEERS[name].package} ({PEERS[name].model})\n{said}\n\n"
        )
    if "--write" in sys.argv:
        PAGE.write_text(page(results), encoding="utf-8")
    return 0 if all(arrived for arrived, _ in results.values()) else 1


if __name__ == "__main__":
    sys.exit(main())

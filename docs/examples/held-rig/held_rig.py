"""A program without anisoscope moves and photographs on a rig that `anisoscope rig hold` keeps open.

A node of ROS 2 or a VI of LabVIEW sends the same lines to the same socket: python held_rig.py RIG.toml ANGLE EXPOSURE
"""

import json
import os
import socket
import sys
import tempfile
from pathlib import Path
from typing import Any

RUNTIME = os.environ.get("XDG_RUNTIME_DIR") or os.environ.get("LOCALAPPDATA") or tempfile.gettempdir()


class HeldRig:
    """Requests as lines of JSON; what can be requested stands in rig/holdline.py."""

    def __init__(self, rig: str) -> None:
        notes = [json.loads(note.read_text("utf-8")) for note in Path(RUNTIME).glob("anisoscope*/*.json")]
        note = next(one for one in notes if one["serves_at"] and one["rig"] == str(Path(rig).resolve()))
        host, _, port = note["serves_at"].rpartition(":")
        self.token = note["token"]
        self.line = socket.create_connection((host, int(port))).makefile("rwb")
        self.devices = self.ask(None, "devices")

    def ask(self, table: str | None, do: str, *arguments: float) -> Any:  # noqa: ANN401
        """Answer to a request; that to the grab of a camera is its (rows, cols) and the bytes of its counts."""
        device = self.devices[table] if table else None
        request = {"token": self.token, "device": device, "do": do, "args": arguments}
        self.line.write(json.dumps(request).encode() + b"\n")
        self.line.flush()
        while (text := self.line.readline()) == b"\n":
            pass  # it is still at it
        answer = json.loads(text or '{"error": "", "text": "the process that held the rig has ended"}')
        if "error" in answer:
            raise SystemExit(answer["text"])
        return (answer["ok"], self.line.read(answer["bytes"])) if "bytes" in answer else answer["ok"]


if __name__ == "__main__":
    held, angle, exposure = HeldRig(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3])
    if not held.ask("stage", "is_homed"):
        held.ask("stage", "home")
    reached = held.ask("stage", "move_to", angle)
    held.ask("light", "on")
    shape, counts = held.ask("camera", "grab", exposure, 1.0)
    held.ask("light", "off")
    Path("frame.raw").write_bytes(counts)
    sys.stdout.write(f"frame.raw: {shape} counts of 16 bits, little-endian, at {reached:.3f} degrees\n")

"""Frames as a broken rig would have taken them, made from those of a finished inspection on a sound rig.

Frames of an inspection by ``dark``, the stage angles and ``again`` for the return; every fault of `FAULTS` makes other
ones of them, in counts.
"""

from dataclasses import replace

import cv2
import numpy as np

from anisoscope.rig.frame import read_frame
from anisoscope.rig.framefolder import write_frame_folder

BLACK, TOP = 64.0, 4095


def frames_of(inspected):
    """The frames of an inspection by their poses: dark, 0, 90, 180, again."""
    found = {}
    for entry in inspected.record.frames:
        frame = read_frame(inspected.folder / entry.name)
        pose = "dark" if frame.kind == "dark" else "again" if entry.again else round(entry.stage_deg) % 360
        found.setdefault(pose, []).append(frame)
    return found


def write_frames(frames, folder):
    """A folder of frames for `anisoscope inspect --frames`."""
    flat = [(frame, pose == "again") for pose, several in frames.items() for frame in several]
    write_frame_folder(folder, [frame for frame, _ in flat], [again for _, again in flat])
    return folder


def counts(frame):
    return frame.counts.astype(float) - BLACK


def with_counts(frame, above_black):
    found = np.clip(np.rint(above_black + BLACK), 0, TOP).astype(np.uint16)
    return replace(frame, counts=found)


def in_poses(change, *poses):
    """A fault that changes all frames of some poses; without any, of all lit ones."""

    def broken(frames):
        chosen = poses or [pose for pose in frames if pose != "dark"]
        return frames | {
            pose: [with_counts(one, change(counts(one))) for one in frames[pose]] for pose in chosen
        }

    return broken


def in_one_frame(change, number=0):
    """A fault that changes one frame of every lit pose."""

    def broken(frames):
        return {
            pose: [
                with_counts(one, change(counts(one))) if pose != "dark" and i == number else one
                for i, one in enumerate(several)
            ]
            for pose, several in frames.items()
        }

    return broken


def top_of(frames):
    return float(np.percentile(counts(frames[0][0]), 99.9))


def soft_saturation(frames):
    top = top_of(frames)
    return in_poses(lambda x: x * (1.0 - 0.25 * np.clip(x / top, 0.0, None)))(frames)


def gamma(frames):
    top = top_of(frames)
    return in_poses(lambda x: np.sign(x) * top * (np.abs(x) / top) ** 0.9)(frames)


def plateau(frames):
    top = 0.6 * top_of(frames)
    return in_poses(lambda x: np.minimum(x, top))(frames)


def automatic_gain(frames):
    mean = counts(frames[0][0]).mean()
    return in_poses(lambda x: x * mean / x.mean(), 90, 180)(frames)


def lamp_sinks(frames):
    found = frames
    for pose, share in ((90, 0.9), (180, 0.8)):
        found = in_poses(lambda x, share=share: share * x, pose)(found)
    return found


def stale_frame(frames):
    return frames | {180: [replace(frames[180][0], counts=frames[90][0].counts), *frames[180][1:]]}


def identical(frames):
    return {
        pose: [replace(one, counts=several[0].counts) for one in several] for pose, several in frames.items()
    }


def gradient(x):
    """10 % from the left edge to the right one."""
    return x * np.linspace(0.95, 1.05, x.shape[1])


def turned_about(angle_deg, radius=132, middle=(258.9, 253.3)):
    """The part lies turned in its fixture: the disc that holds it is that of another angle of the stage."""

    def broken(frames):
        size = frames[0][0].counts.shape
        y, x = np.indices(size)
        inside = np.hypot(x - middle[0], y - middle[1]) < radius

        def turned(pose):
            seen = frames[((0 if pose == "again" else pose) + angle_deg) % 360]
            return [
                replace(one, counts=np.where(inside, seen[i % len(seen)].counts, one.counts))
                for i, one in enumerate(frames[pose])
            ]

        return frames | {pose: turned(pose) for pose in (0, 180, "again")}

    return broken


def torn(x):
    found = x.copy()
    found[len(x) // 2 : len(x) // 2 + len(x) // 4] = -BLACK
    return found


def shifted_rows(x):
    found = x.copy()
    found[len(x) // 2 :] = np.roll(x[len(x) // 2 :], 40, axis=1)
    return found


def dropped_rows(x):
    half, lost = len(x) // 2, len(x) // 16
    return np.concatenate([x[:half], x[half + lost :], np.repeat(x[-1:], lost, axis=0)])


def dirty_marker(frames):
    """The marker to the right at stage angle 0, which turns with the plate."""
    found = frames
    for pose in frames:
        if pose == "dark":
            continue
        turn = np.radians(0.0 if pose == "again" else pose)
        column, row = 258.9 + 195.0 * np.cos(turn), 253.3 - 195.0 * np.sin(turn)

        def smeared(x, column=column, row=row):
            y, x_px = np.indices(x.shape)
            return np.where(np.hypot(x_px - column - 15, y - row) < 22, 200.0, x)

        found = in_poses(smeared, pose)(found)
    return found


def lossy(x):
    scaled = np.clip((x + BLACK) / TOP * 255.0, 0, 255).astype(np.uint8)
    _, packed = cv2.imencode(".jpg", scaled, [cv2.IMWRITE_JPEG_QUALITY, 60])
    return cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE) / 255.0 * TOP - BLACK


def bent(x):
    """Barrel: a corner moves inwards by 1.2 %."""
    middle = 0.5 * (np.array(x.shape[::-1]) - 1.0)
    row, column = np.indices(x.shape)
    away = np.stack([column, row], axis=-1) - middle
    stretch = 1.0 + 0.012 * (away**2).sum(axis=-1) / (middle**2).sum()
    at = (middle + away * stretch[..., None]).astype(np.float32)
    return cv2.remap(
        x.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )


FAULTS = {
    "60 counts more in lit frames": in_poses(lambda x: x + 60.0),
    "120 counts more in lit frames": in_poses(lambda x: x + 120.0),
    "dark frames 60 counts lower": in_poses(lambda x: x - 60.0, "dark"),
    "bright pose 25 % dimmer, at its return too": in_poses(lambda x: 0.75 * x, 0, "again"),
    "soft saturation, 25 % short at the peak": soft_saturation,
    "exposure of another pose at 90°, 25 % short": in_poses(lambda x: 0.75 * x, 90),
    "automatic gain": automatic_gain,
    "one of the frames at 180° shows 90°": stale_frame,
    "first frame of every pose half exposed": in_one_frame(lambda x: 0.5 * x),
    "plateau at 60 % of the peak": plateau,
    "all frames of a pose alike bit for bit": identical,
    "a tenth of the stated exposure": in_poses(lambda x: 0.1 * x),
    "gain doubled": in_poses(lambda x: 2.0 * x),
    "gain halved": in_poses(lambda x: 0.5 * x),
    "lamp 10 % a pose down, back at the return": lamp_sinks,
    "lamp 10 % up at 180°": in_poses(lambda x: 1.1 * x, 180),
    "part turned by 180° in its seat": turned_about(180),
    "rows of zeros in one frame of every pose": in_one_frame(torn),
    "rows shifted in one frame of every pose": in_one_frame(shifted_rows),
    "rows dropped in one frame of every pose": in_one_frame(dropped_rows),
    "light rises by 10 % across the picture": in_poses(gradient),
    "gamma 0.9": gamma,
    "one marker dirty": dirty_marker,
    "pictures mirrored": in_poses(lambda x: x[:, ::-1]),
    "pictures upside down": in_poses(lambda x: x[::-1]),
    "JPEG": in_poses(lossy),
    "barrel, 1.2 % at the corners": in_poses(bent),
}
"""Functions that make broken frames of sound ones, by what broke."""

"""The refined scene, for pictures of a result: ``scene.npz`` beside ``result.json``.

Large scenes are thinned, so that the file stays small; how many points and observations there were is kept.
"""

import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.io.checks import set_array
from handeye_fg.io.fields import reason
from handeye_fg.io.files import write_atomic
from handeye_fg.types import Indices

SCENE_NAME = "scene.npz"
MOST_POINTS = 12_000
MOST_OBSERVATIONS = 40_000
_LARGEST_BYTES = 64 * 2**20  # of a file that is read; one of ours has a fiftieth


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RefinedScene:
    """Points, observations and images of a calibration.

    Attributes:
        points: positions (p, 3) of scene points, metres: in the base, for eye-to-hand in the gripper.
        n_points: how many there were before thinning.
        image: which image (m,) an observation is of, by its place in ``names``.
        pixels: observed (m, 2).
        errors: predicted minus observed (m, 2), pixels.
        sigmas: standard deviations (m,) of a coordinate of these, pixels.
        n_observations: how many there were before thinning.
        names: of the images that were used (n,).
        thumbnails: small JPEG images by name; not all images need to have one.
        path: X (k, 4, 4) after each step of the refinement, the linear start first, metres.
    """

    points: Array
    n_points: int
    image: Indices
    pixels: Array
    errors: Array
    sigmas: Array
    n_observations: int
    names: tuple[str, ...]
    thumbnails: Mapping[str, bytes]
    path: Array

    def __post_init__(self) -> None:
        m = len(self.image)
        set_array(self, "points", (len(self.points), 3))
        for name in ("pixels", "errors"):
            set_array(self, name, (m, 2))
        set_array(self, "sigmas", (m,))
        set_array(self, "path", (len(self.path), 4, 4))
        if m and not 0 <= self.image.min() <= self.image.max() < len(self.names):
            raise ValueError("image has numbers that are not those of names")


def write_scene(scene: RefinedScene, folder: Path) -> Path:
    """Write ``scene.npz``, whole or not at all.

    Raises:
        InputDataError: the file cannot be written.
    """
    names = list(scene.thumbnails)
    buffer = io.BytesIO()
    np.savez(
        buffer,
        points=scene.points.astype(np.float32),
        image=scene.image.astype(np.int32),
        pixels=scene.pixels.astype(np.float32),
        errors=scene.errors.astype(np.float32),
        sigmas=scene.sigmas.astype(np.float32),
        path=scene.path,
        counts=np.array([scene.n_points, scene.n_observations]),
        names=np.array(scene.names, dtype=np.str_),
        thumbnail_names=np.array(names, dtype=np.str_),
        thumbnail_ends=np.cumsum([len(scene.thumbnails[name]) for name in names], dtype=np.int64),
        thumbnails=np.frombuffer(b"".join(scene.thumbnails.values()), dtype=np.uint8),
    )
    return write_atomic(Path(folder) / SCENE_NAME, buffer.getvalue())


def read_scene(folder: Path) -> RefinedScene | None:
    """The scene beside a ``result.json``; None where there is none.

    Raises:
        InputDataError: the file is damaged, or not one of ours.
    """
    path = Path(folder) / SCENE_NAME
    if not path.is_file():
        return None
    try:
        _require_small(path)
        with np.load(path, allow_pickle=False) as found:
            return _scene(found)
    except (OSError, ValueError, KeyError, IndexError, TypeError, zipfile.BadZipFile) as error:
        raise InputDataError(
            f"scene file {path}: not a scene ({reason(error)}); remove it, or calibrate again to write it"
        ) from error


def _require_small(path: Path) -> None:
    """Refuse an archive that unpacks to more than any scene: a bomb."""
    with zipfile.ZipFile(path) as archive:
        if sum(item.file_size for item in archive.infolist()) > _LARGEST_BYTES:
            raise ValueError("it is larger than any scene")


def _scene(found: Mapping[str, Array]) -> RefinedScene:
    n_points, n_observations = found["counts"].tolist()
    ends = found["thumbnail_ends"].tolist()
    pictures = found["thumbnails"].tobytes()
    starts = [0, *ends][: len(ends)]
    names = found["thumbnail_names"].tolist()
    arrays = {
        field.name: np.asarray(found[field.name], dtype=np.float64)
        for field in fields(RefinedScene)
        if field.name in ("points", "pixels", "errors", "sigmas", "path")
    }
    return RefinedScene(
        **arrays,
        image=np.asarray(found["image"], dtype=np.int64),
        n_points=int(n_points),
        n_observations=int(n_observations),
        names=tuple(found["names"].tolist()),
        thumbnails={
            name: pictures[start:end] for name, start, end in zip(names, starts, ends, strict=True)
        },
    )

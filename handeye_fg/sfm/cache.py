"""The folder of a reconstruction: written whole or not at all, and found again when nothing changed."""

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pycolmap

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.options import SfmOptions
from handeye_fg.sfm.database import described
from handeye_fg.sfm.model import to_sfm_model
from handeye_fg.sfm.stages import DATABASE, digest_of, not_written, part
from handeye_fg.turns import RobotTurns
from handeye_fg.types import CameraModel, Fragment, SfmModel

# Raised whenever the settings in this package change, so that older models are not reused.
RECIPE = 5
_INPUTS = "inputs.json"


def file_digests(
    images: Path, names: Sequence[str], masks: Path | None
) -> dict[str, tuple[str, str | None]]:
    """SHA-256 of each image's file and its mask's.

    Raises:
        InputDataError: an image or a mask cannot be read.
    """
    return {
        name: (
            _file_digest(images / name),
            None if masks is None else _file_digest(masks / f"{name}.png"),
        )
        for name in names
    }


def inputs_digest(
    files: Mapping[str, Sequence[str | None]],
    cameras: Mapping[str, CameraModel] | None,
    options: SfmOptions,
    seed: int,
    *,
    refine_intrinsics: bool,
    turns: RobotTurns | None = None,
    poses: Array | None = None,
) -> str:
    """SHA-256 of everything that a reconstruction depends on."""
    settings = {
        "recipe": RECIPE,
        "pycolmap": pycolmap.__version__,
        "options": {**asdict(options), "threads": None},
        "seed": seed,
        "turns": None if turns is None else [turns.setup, turns.rotations.tolist()],
        "poses": None if poses is None else poses.tolist(),
        "refine_intrinsics": refine_intrinsics,
        "cameras": described(cameras),
        "files": [[name, *digests] for name, digests in files.items()],
    }
    return digest_of(settings)


def _file_digest(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputDataError(
            f"{path}: cannot be read ({error.strerror}); check the path"
        ) from error


def stored_model(folder: Path, digest: str) -> SfmModel | None:
    """The model in the folder if it was made from the same inputs, else None."""
    try:
        stored = json.loads((folder / _INPUTS).read_text(encoding="utf-8"))
        if stored["digest"] != digest:
            return None
        unregistered = tuple((str(name), str(reason)) for name, reason in stored["unregistered"])
        static_share = float(stored["static_share"])
        fragments = tuple(
            Fragment(
                names=tuple(map(str, names)),
                world_T_camera=np.array(poses, dtype=float),
                cameras={folder: _camera(*camera) for folder, camera in cameras.items()},
            )
            for names, poses, cameras in stored["fragments"]
        )
        reconstruction = pycolmap.Reconstruction(folder)
    except (OSError, ValueError, LookupError, TypeError, RuntimeError):
        return None  # damaged or of another version: made again
    model = to_sfm_model(reconstruction, unregistered)
    return replace(model, static_share=static_share, fragments=fragments)


def _camera(model: str, width: int, height: int, params: Sequence[float]) -> CameraModel:
    """A camera as it was described."""
    return CameraModel(model=model, width=width, height=height, params=np.array(params))


def check_replaceable(folder: Path) -> None:
    """Refuse to replace a folder that holds something else than a reconstruction of ours.

    Raises:
        InputDataError: it does.
    """
    if not folder.exists() or (folder / _INPUTS).is_file():
        return
    if not folder.is_dir() or any(folder.iterdir()):
        raise InputDataError(
            f"{folder} exists and was not written by handeye-fg; remove it or choose another output "
            "folder"
        )


@contextmanager
def staging(folder: Path) -> Iterator[Path]:
    """A new folder beside ``folder``, on the same file system, that is gone in the end.

    Raises:
        InputDataError: it cannot be made.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    except OSError as error:
        raise InputDataError(
            f"{folder}: cannot be written ({error.strerror}); choose another output folder"
        ) from error
    try:
        yield temporary
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def publish(
    stages: Path,
    folder: Path,
    database: Path,
    reconstruction: pycolmap.Reconstruction,
    model: SfmModel,
    digest: str,
) -> None:
    """Put the model, its database and the digest of its inputs into the folder's place at once.

    Args:
        stages: folder of all stages, on the same file system.
        folder: what to replace.
        database: the model's database; it stays, for later runs.
        reconstruction: the model as COLMAP has it.
        model: the same as we have it, with what COLMAP's files do not hold.
        digest: of the inputs.

    Raises:
        InputDataError: something cannot be written.
    """
    content = {
        "digest": digest,
        "unregistered": model.unregistered,
        "static_share": model.static_share,
        "fragments": [
            [one.names, one.world_T_camera.tolist(), described(one.cameras)]
            for one in model.fragments
        ],
    }
    try:
        with part(stages) as work:
            finished = work / "finished"
            finished.mkdir()
            reconstruction.write(finished)
            shutil.copyfile(database, finished / DATABASE)
            (finished / _INPUTS).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
            if folder.exists():
                folder.replace(work / "replaced")
            finished.replace(folder)
    except (OSError, RuntimeError, ValueError) as error:
        raise not_written(folder, error) from error

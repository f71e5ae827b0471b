"""Stages of a reconstruction: each leaves its output in a folder, where the next run finds it.

The folder's name holds a digest of all that the stage depends on: a change of that begins a new folder,
and no other stage's. A folder appears at once, and COLMAP's databases are sound at every moment, so that a
run continues where the last one ended, however it ended. Entry point ``open_stage``.
"""

import hashlib
import json
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pycolmap

from handeye_fg.errors import InputDataError

DATABASE = "database.db"
_ABOUT = "stage.json"
_PART = ".part-"
_DIGITS = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """A stage's folder.

    Attributes:
        folder: where its output is.
        key: all that the output depends on.
        facts: what was found when the folder was begun.
        older: folders of the same stage for other keys, of which parts may still be valid.
    """

    folder: Path
    key: Mapping[str, Any]
    facts: Mapping[str, Any]
    older: tuple["Stage", ...] = ()

    @property
    def database(self) -> Path:
        """COLMAP's database in the folder, of the stages that have one."""
        return self.folder / DATABASE

    @property
    def kind(self) -> str:
        """Name of the stage."""
        return self.folder.name.rpartition("-")[0]

    @property
    def digest(self) -> str:
        """Of the key."""
        return digest_of(self.key)

    def finish(self) -> None:
        """Remove the older folders: what was valid of them is in this one."""
        for stage in self.older:
            shutil.rmtree(stage.folder, ignore_errors=True)


Build = Callable[[Path, tuple[Stage, ...]], Mapping[str, Any]]
"""Fills a stage's new folder, with the help of older ones, and returns facts to keep."""


def digest_of(value: object) -> str:
    """SHA-256 of a value that JSON can hold; what it cannot counts by its text."""
    text = json.dumps(value, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()


def open_stage(stages: Path, kind: str, key: Mapping[str, Any], build: Build) -> Stage:
    """Find the folder of a stage, or begin it.

    Args:
        stages: folder of all stages.
        kind: name of the stage.
        key: all that its output depends on, as JSON can hold it.
        build: fills the folder if there is none.

    Raises:
        InputDataError: it cannot be written.
    """
    folder = stages / f"{kind}-{digest_of(key)[:_DIGITS]}"
    found = {stage.folder: stage for stage in _stages(stages, kind)}
    older = tuple(stage for path, stage in found.items() if path != folder)
    if folder not in found:
        try:
            shutil.rmtree(folder, ignore_errors=True)  # damaged
            with part(stages) as work:
                begun = work / kind
                begun.mkdir()
                facts = build(begun, older)
                about = json.dumps({"key": key, "facts": facts}, default=str)
                (begun / _ABOUT).write_text(about, encoding="utf-8")
                begun.replace(folder)
        except (OSError, RuntimeError) as error:  # the latter COLMAP's
            raise not_written(folder, error) from error
        found[folder] = _read(folder)
    opened = found[folder]
    return Stage(folder=folder, key=opened.key, facts=opened.facts, older=older)


def not_written(path: Path, error: Exception) -> InputDataError:
    """The sentence for a full disk and the like."""
    reason = getattr(error, "strerror", None) or error
    return InputDataError(
        f"{path}: cannot be written ({reason}); check the free disk space, or choose another output "
        "folder; what is finished is kept, and the same command continues from there"
    )


@contextmanager
def part(stages: Path) -> Iterator[Path]:
    """A folder for what is not yet whole; what is left in it in the end is removed."""
    with TemporaryDirectory(prefix=_PART, dir=stages, ignore_cleanup_errors=True) as folder:
        yield Path(folder)


def prepare(stages: Path) -> Path:
    """Make the folder of all stages, and remove what a killed run left half-written there.

    Raises:
        InputDataError: it cannot be made.
    """
    try:
        stages.mkdir(parents=True, exist_ok=True)
        for left in stages.glob(f"{_PART}*"):
            shutil.rmtree(left, ignore_errors=True)
    except OSError as error:
        raise not_written(stages, error) from error
    return stages


def _stages(stages: Path, kind: str) -> list[Stage]:
    """The stages of a kind that can be read."""
    named = re.compile(re.escape(kind) + f"-[0-9a-f]{{{_DIGITS}}}")
    found = []
    for folder in sorted(stages.iterdir()):
        if named.fullmatch(folder.name):
            try:
                found.append(_read(folder))
            except (OSError, RuntimeError, ValueError, LookupError, TypeError):
                continue  # damaged, or of another version
    return found


def _read(folder: Path) -> Stage:
    about = json.loads((folder / _ABOUT).read_text(encoding="utf-8"))
    stage = Stage(folder=folder, key=dict(about["key"]), facts=dict(about["facts"]))
    images = {**stage.key, **stage.facts}.get("images")
    if images is not None and stage.database.exists():
        with pycolmap.Database.open(stage.database) as db:
            if db.num_images() != len(images):
                raise ValueError(f"{stage.database} is damaged")
    return stage

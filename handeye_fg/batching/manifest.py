"""Which data sets a batch has: a CSV or YAML manifest, or a folder of folders; ``read_data_sets``."""

import csv
import io
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

from handeye_fg.batching.sources import is_url
from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import reason, shown
from handeye_fg.io.files import read_text
from handeye_fg.io.yaml_files import read_yaml

_KEY = "data_sets"
_REMEDY = "correct the manifest"
_LARGEST_FILE = 50_000_000  # characters; a data set takes some hundred
_LONGEST_NAME = 120
_OF_IMAGES = ("camera", "masks", "target")  # a model has its own intrinsics, and no images
_NOT_IN_NAMES = set('/\\:*?"<>|')
# Where a folder of folders has what the manifest's columns name.
_PLACES = {
    "images": ("images",),
    "model": ("model", "sparse/0", "sparse"),
    "poses": ("poses.csv",),
    "camera": ("camera.yaml",),
    "masks": ("masks",),
    "target": ("target.yaml",),
    "config": ("config.toml",),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSet:
    """One data set; each place is a path or an fsspec URL such as ``s3://robots/7/images``.

    Attributes:
        name: its name, and that of its folder in the output.
        poses: poses file.
        images: folder of the images; None where ``model`` is given.
        model: folder of a COLMAP model instead of images.
        camera: camera file, or of several cameras the folder of them.
        masks: folder of masks.
        target: target file.
        config: options file (TOML); None: the options of the batch.
        reference: ``result.json`` of an earlier calibration, or its folder, to hold the new one against.
    """

    name: str
    poses: str
    images: str | None = None
    model: str | None = None
    camera: str | None = None
    masks: str | None = None
    target: str | None = None
    config: str | None = None
    reference: str | None = None

    def __post_init__(self) -> None:
        problem = _problem(self.name)
        if problem:
            raise ValueError(f"name is {shown(self.name)}, but {problem}")
        if not self.poses:
            raise ValueError("poses is empty, but must name the poses file")
        if (self.images is None) == (self.model is None):
            raise ValueError(
                "images and model are both "
                f"{'empty' if self.images is None else 'given'}, but one of the two must be given"
            )
        if self.model is not None:
            given = [key for key in _OF_IMAGES if getattr(self, key) is not None]
            if given:
                raise ValueError(
                    f"{given[0]} is given, but a model has its own intrinsics and no images; leave it empty"
                )


COLUMNS = tuple(field.name for field in fields(DataSet))


def read_data_sets(source: Path, left_out: Path | None = None) -> tuple[DataSet, ...]:
    """Read a manifest, or look through a folder of folders.

    Relative paths in a manifest start at its folder. In a folder of folders each folder is a data set with
    ``images/`` (or a COLMAP model: ``model/``, ``sparse/0/`` or ``sparse/``), ``poses.csv`` and optionally
    ``camera.yaml``, ``masks/``, ``target.yaml`` and ``config.toml``.

    Args:
        source: CSV file, YAML file (``.yaml``, ``.yml``), or folder.
        left_out: a folder that is no data set, wherever it is.

    Raises:
        InputDataError: the manifest breaks its form (row and column are named), or there is no data set.
    """
    if source.is_dir():
        found = list(_in_folders(source, left_out))
    elif source.suffix.lower() in (".yaml", ".yml"):
        found = list(_of_yaml(source))
    else:
        found = list(_of_csv(source))
    if not found:
        raise InputDataError(
            f"batch {source}: there is no data set; give a manifest with a row for each, or a folder "
            "with a folder for each"
        )
    _require_distinct(found)
    return tuple(data for _, data in found)


def checked(data_sets: Sequence[DataSet]) -> tuple[DataSet, ...]:
    """Data sets that were made in Python, their paths made absolute.

    Raises:
        InputDataError: there is none, or two have one name.
    """
    if not data_sets:
        raise InputDataError("batch: there is no data set; give at least one")
    _require_distinct([(f"data_sets[{i}]", data) for i, data in enumerate(data_sets)])
    return tuple(_placed(data, Path.cwd()) for data in data_sets)


def _problem(name: str) -> str:
    """Why a name is no name of a folder in the output; "" if it is."""
    if not name or len(name) > _LONGEST_NAME:
        return f"must have 1 to {_LONGEST_NAME} characters"
    if not name[0].isalnum() or name[-1] in ". ":
        return "must begin with a letter or digit, and not end with a dot or space"
    if not name.isprintable() or _NOT_IN_NAMES & set(name):
        return f"must have no control characters and none of {' '.join(sorted(_NOT_IN_NAMES))}"
    if _folded(name) in {"summary.csv", "summary.html"}:
        return "is the name of a file of the batch"
    return ""


def _folded(name: str) -> str:
    """Names that some file systems take for one are one."""
    return unicodedata.normalize("NFC", name).casefold()


def _require_distinct(found: Sequence[tuple[str, DataSet]]) -> None:
    first: dict[str, str] = {}
    for where, data in found:
        other = first.setdefault(_folded(data.name), where)
        if other != where:
            raise InputDataError(
                f"{where}, column name: {shown(data.name)} is already the name in {other}, but each "
                "data set has a folder of its own; change one of the two"
            )


def _in_folders(folder: Path, left_out: Path | None) -> Iterator[tuple[str, DataSet]]:
    outside = None if left_out is None else left_out.resolve()
    for inside in sorted(folder.iterdir()):
        if not inside.is_dir() or inside.name.startswith(".") or inside.resolve() == outside:
            continue
        places = {
            key: next((str(inside / place) for place in some if (inside / place).exists()), "")
            for key, some in _PLACES.items()
        }
        if places["model"] and not places["images"]:
            places |= dict.fromkeys(_OF_IMAGES, "")
        else:  # where images are missing too, the calibration says so
            places |= {"images": str(inside / "images"), "model": ""}
        places["poses"] = places["poses"] or str(inside / "poses.csv")
        yield _row(f"folder {inside}", {"name": inside.name, **places}, Path.cwd())


def _of_csv(path: Path) -> Iterator[tuple[str, DataSet]]:
    text = read_text(path, "manifest")
    if "\n" not in text.strip():
        raise InputDataError(
            f"manifest {path}: there is only one line; write the header name,images,poses,... and "
            "below it a row for each data set"
        )
    rows = csv.reader(io.StringIO(text), strict=True, skipinitialspace=True)
    try:
        header = [cell.strip() for cell in next(rows)]
        _check_columns(f"manifest {path}, line 1", header)
        for row in rows:
            cells = [cell.strip() for cell in row]
            if not any(cells):
                continue
            where = f"manifest {path}, line {rows.line_num}"
            if len(cells) > len(header):
                raise InputDataError(
                    f"{where}: {len(cells)} cells, but the header has {len(header)} columns; put "
                    "quotes around cells with commas"
                )
            yield _row(where, dict(zip(header, cells, strict=False)), path.parent)
    except csv.Error as error:
        raise InputDataError(
            f"manifest {path}, line {rows.line_num}: not a CSV table ({reason(error)}); {_REMEDY}"
        ) from error


def _of_yaml(path: Path) -> Iterator[tuple[str, DataSet]]:
    wanted = f"a mapping with the key {_KEY}, a list of data sets"
    manifest = read_yaml(path, "manifest", wanted, _REMEDY, _LARGEST_FILE)
    for key in manifest.values:
        if key != _KEY:
            raise InputDataError(
                f"manifest {path}: {shown(key)} is not a key of a manifest, but {_KEY} is; {_REMEDY}"
            )
    for number, item in enumerate(manifest.mappings(_KEY)):
        where = f"manifest {path}, {_KEY}[{number}]"
        _check_columns(where, list(item.values))
        given = [key for key, value in item.values.items() if value is not None]
        yield _row(where, {key: item.text(key) for key in given}, path.parent)


def _check_columns(where: str, names: Sequence[str]) -> None:
    for name in names:
        if name not in COLUMNS:
            raise InputDataError(
                f"{where}: column {shown(name)} is unknown, but one of {', '.join(COLUMNS)} was "
                f"expected; {_REMEDY}"
            )
        if names.count(name) > 1:
            raise InputDataError(f"{where}: column {name} occurs twice; remove one")
    for name in ("name", "poses"):
        if name not in names:
            raise InputDataError(f"{where}: column {name} is missing; add it")


def _row(where: str, cells: Mapping[str, str], base: Path) -> tuple[str, DataSet]:
    given = {"name": "", "poses": "", **{key: value for key, value in cells.items() if value}}
    try:
        return where, _placed(DataSet(**given), base)
    except ValueError as error:
        raise InputDataError(f"{where}, column {error}; {_REMEDY}") from error


def _placed(data: DataSet, base: Path) -> DataSet:
    """The data set with its paths absolute."""
    places = {
        key: value if is_url(value) else str((base / value).absolute())
        for key, value in asdict(data).items()
        if key != "name" and value is not None
    }
    return replace(data, **places)

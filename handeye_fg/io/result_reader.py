"""Reading ``result.json`` back, with every field checked."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, cast, get_args

from handeye_fg.errors import InputDataError
from handeye_fg.findings import FreeDirection, LinearStart, NoiseLevels, SecondStart
from handeye_fg.io.accuracy import read_accuracy
from handeye_fg.io.camera_results import CameraReport
from handeye_fg.io.certainty import read_certainty
from handeye_fg.io.earlier import completed, may_lack
from handeye_fg.io.fields import Fields, finite, reason, shown
from handeye_fg.io.files import read_text
from handeye_fg.io.holdout import read_holdout
from handeye_fg.io.image_results import read_image
from handeye_fg.io.other_intrinsics import read_offset, read_other
from handeye_fg.io.read_as import read_read_as
from handeye_fg.io.results import (
    FILE_NAME,
    SCHEMA_VERSION,
    Result,
    SfmSummary,
    Status,
    TargetSummary,
    parent_frame,
    to_document,
)
from handeye_fg.io.scene_file import read_scene
from handeye_fg.patterns import TargetKind
from handeye_fg.types import CameraModel, Setup

Kind = Literal["rotation", "translation", "scale"]


def load_result(path: str | Path) -> Result:
    """Read a ``result.json``.

    Args:
        path: the file, or the folder that holds it.

    Returns:
        The result; arrays are exactly those that were saved, converted units agree to rounding.

    Raises:
        InputDataError: the file is missing, not JSON, of another version, of a failed calibration,
            or breaks the schema.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from tempfile import TemporaryDirectory
        >>> from handeye_fg.simulate import simulate_poses
        >>> robot, camera, _ = simulate_poses(np.random.default_rng(0), n_poses=10)
        >>> result = hf.solve(robot, camera)
        >>> with TemporaryDirectory() as folder:
        ...     _ = result.save(folder)
        ...     again = hf.load_result(folder)
        >>> bool(np.array_equal(again.matrix, result.matrix))
        True
    """
    path = Path(path)
    if path.is_dir():
        path = path / FILE_NAME
    try:
        document = json.loads(read_text(path, "result file"))
    except (ValueError, RecursionError) as error:
        raise InputDataError(
            f"result file {path}: not valid JSON ({reason(error)}); calibrate again to write it"
        ) from error
    return replace(
        from_document(document, where=f"result file {path}"), scene=read_scene(path.parent)
    )


def from_document(document: object, where: str = "result document") -> Result:
    """The result that a document of :func:`to_document` says.

    Args:
        document: parsed JSON.
        where: its name in error messages.

    Returns:
        The result; what an earlier version did not write is unknown (None).

    Raises:
        InputDataError: the document is of another version, of a failed calibration, or breaks the
            schema.
    """
    if not isinstance(document, dict):
        raise InputDataError(
            f"{where}: found {shown(document)}, but wanted an object; give a result.json"
        )
    fields = Fields(
        where=where,
        remedy="calibrate again to write a valid file",
        values=cast("Mapping[str, object]", completed(document)),
    )
    fields.text("schema_version", (SCHEMA_VERSION,))
    setup = cast("Setup", fields.text("setup", get_args(Setup)))
    status = fields.text("status", ("ok", "partial", "failed"))
    if status == "failed":
        raise InputDataError(
            f"{where}: the calibration failed ({fields.text('message')}), so there is no result;"
            " remove the cause and calibrate again"
        )
    calibration, scale = fields.mapping("calibration"), fields.mapping("metres_per_world_unit")
    calibration.text("parent", (parent_frame(setup),))
    cameras = fields.mappings("cameras") if "cameras" in fields.values else ()
    std = scale.optional_number("std")
    noise = _noise(fields.optional_mapping("noise"))
    try:
        result = Result(
            status=cast("Status", status),
            setup=setup,
            message=fields.text("message"),
            matrix=calibration.array("matrix", (4, 4)),
            covariance=calibration.optional_array("covariance", (6, 6)),
            free_directions=_free_directions(calibration),
            metres_per_world_unit=scale.number("value"),
            metres_per_world_unit_std=math.nan if std is None else std,
            base_T_world=fields.optional_array("base_T_world", (4, 4)),
            noise=noise,
            initial=_start(fields.mapping("initial")),
            images=tuple(read_image(image) for image in fields.mappings("images")),
            **_intrinsics(fields.optional_mapping("intrinsics")),
            sfm=_sfm(fields.optional_mapping("sfm")),
            cameras=tuple(_camera(camera, setup) for camera in cameras),
            target=_target(fields.mapping("target")) if "target" in fields.values else None,
            certainty=read_certainty(fields.mapping("certainty"), noise)
            if noise is not None and "certainty" in fields.values
            else None,
            second_start=_second_start(fields.mapping("second_start"))
            if "second_start" in fields.values
            else None,
            holdout=read_holdout(fields.mapping("holdout")) if "holdout" in fields.values else None,
            accuracy=read_accuracy(fields.mapping("accuracy"))
            if "accuracy" in fields.values
            else None,
            poses_read_as=read_read_as(fields.mapping("poses_read_as"))
            if "poses_read_as" in fields.values
            else {},
            repeatability=1e-3 * fields.mapping("data_sheet").number("repeatability_mm")
            if "data_sheet" in fields.values
            else None,
            observability=_figures(fields.mapping("observability")),
            timing_s=_figures(fields.mapping("timing_s")),
            provenance=_provenance(fields.mapping("provenance")),
        )
    except ValueError as error:  # Result refuses what cannot be one
        raise InputDataError(f"{where}: {reason(error)}; {fields.remedy}") from error
    _check_agrees(document, to_document(result), fields, "")
    return result


def _check_agrees(found: object, wanted: object, fields: Fields, key: str) -> None:
    """Refuse missing and unknown keys, and figures that contradict the ones they derive from.

    What earlier versions did not write may be missing.
    """
    problem = ""
    if isinstance(wanted, dict) and isinstance(found, dict):
        strange = (set(found) ^ set(wanted)) - (may_lack(key) - set(found))
        if strange:
            name = min(strange, key=str)
            problem = f"{shown(name)} is {'an unknown key' if name in found else 'missing'}"
        else:
            for name in (name for name in wanted if name in found):
                _check_agrees(found[name], wanted[name], fields, f"{key}.{name}".lstrip("."))
    elif isinstance(wanted, list) and isinstance(found, list):
        if len(found) != len(wanted):
            problem = f"it has {len(found)} items, but must have {len(wanted)}"
        else:
            for i, value in enumerate(wanted):
                _check_agrees(found[i], value, fields, f"{key}[{i}]")
    elif isinstance(wanted, float):
        number = finite(found)
        if number is None or not math.isclose(number, wanted, rel_tol=1e-9, abs_tol=1e-9):
            problem = f"it is {shown(found)}, but must be {wanted!r}, as the other fields say"
    elif type(found) is not type(wanted):
        problem = f"it is {shown(found)}, but must be like {shown(wanted)}"
    if problem:
        raise InputDataError(f"{fields.where}: {key or 'root'}: {problem}; {fields.remedy}")


def _intrinsics(fields: Fields | None) -> dict[str, Any]:
    """The fields of the result that tell of the intrinsics."""
    if fields is None:
        return {}
    camera = CameraModel(
        model=fields.text("model"),
        width=fields.integer("width", least=1),
        height=fields.integer("height", least=1),
        params=fields.array("params", (None,)),
    )
    if fields.number("first_pixel_centre") != 0.5:
        raise fields.error("first_pixel_centre", "0.5")
    return {
        "camera": camera,
        "intrinsics_refined": fields.flag("refined"),
        "intrinsics_std": fields.array("std", camera.params.shape),
        "intrinsics_note": fields.text("note"),
        "intrinsics_correlation": fields.optional_array("correlation", (len(camera.params), 6)),
        "other_intrinsics": read_other(fields.optional_mapping("other")),
        "focal_offset": read_offset(fields.optional_mapping("focal_offset")),
    }


def _noise(fields: Fields | None) -> NoiseLevels | None:
    if fields is None:
        return None
    pixel = fields.optional_number("pixel_px")
    return NoiseLevels(
        pixel=math.nan if pixel is None else pixel,
        robot_rotation=math.radians(fields.number("robot_rotation_deg")),
        robot_translation=fields.number("robot_translation_mm") / 1e3,
        estimated=fields.flag("estimated"),
        image_inflation=fields.number("image_inflation"),
        corner=fields.optional_number("corner_px"),
    )


def _sfm(fields: Fields | None) -> SfmSummary | None:
    if fields is None:
        return None
    return SfmSummary(
        n_images=fields.integer("n_images"),
        n_registered=fields.integer("n_registered"),
        n_points=fields.integer("n_points"),
        n_observations=fields.integer("n_observations"),
        mean_reprojection_px=fields.number("mean_reprojection_px"),
    )


def _target(fields: Fields) -> TargetSummary:
    return TargetSummary(
        kind=fields.text("kind", get_args(TargetKind)),
        n_images=fields.integer("n_images"),
        n_corners=fields.integer("n_corners"),
        rms_px=fields.number("rms_px"),
        corner_px=fields.number("corner_px"),
        base_T_target=fields.array("base_T_target", (4, 4)),
        note=fields.text("note"),
    )


def _camera(fields: Fields, setup: Setup) -> CameraReport:
    calibration, relative = fields.mapping("calibration"), fields.mapping("first_T_camera")
    calibration.text("parent", (parent_frame(setup),))
    return CameraReport(
        name=fields.text("name"),
        matrix=calibration.array("matrix", (4, 4)),
        covariance=calibration.array("covariance", (6, 6)),
        free_directions=_free_directions(calibration),
        **_intrinsics(fields.mapping("intrinsics")),
        pixel=fields.number("pixel_px"),
        first_T_camera=relative.array("matrix", (4, 4)),
        first_T_camera_covariance=relative.array("covariance", (6, 6)),
    )


def _free_directions(calibration: Fields) -> tuple[FreeDirection, ...]:
    return tuple(
        _free_direction(direction) for direction in calibration.mappings("free_directions")
    )


def _free_direction(fields: Fields) -> FreeDirection:
    return FreeDirection(
        kind=cast("Kind", fields.text("kind", get_args(Kind))),
        vector=fields.array("vector", (3,)),
        frame=fields.text("frame"),
        description=fields.text("description"),
    )


def _second_start(fields: Fields) -> SecondStart:
    return SecondStart(
        agrees=fields.flag("agrees"),
        restarted=fields.flag("restarted"),
        rotation=math.radians(fields.number("rotation_deg")),
        translation=fields.number("translation_mm") / 1e3,
    )


def _start(fields: Fields) -> LinearStart:
    return LinearStart(
        method=fields.text("method"),
        gripper_T_camera=fields.array("matrix", (4, 4)),
        base_T_world=fields.optional_array("base_T_world", (4, 4)),
        metres_per_world_unit=fields.number("metres_per_world_unit"),
        residual_rotation=math.radians(fields.number("residual_rotation_deg")),
        residual_translation=fields.number("residual_translation_mm") / 1e3,
    )


def _figures(fields: Fields) -> dict[str, float]:
    figures = {name: fields.optional_number(name) for name in fields.values}
    return {name: math.nan if figure is None else figure for name, figure in figures.items()}


def _provenance(fields: Fields) -> dict[str, str | int]:
    return {
        name: fields.text(name)
        if isinstance(value, str)
        else fields.integer(name, least=-(2**63), most=2**63)
        for name, value in fields.values.items()
    }

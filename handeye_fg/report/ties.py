"""What the data can hardly tell apart, in words; entry point ``ties``."""

import math

from handeye_fg.io.camera_results import Calibrated, std_rotation_deg, std_translation_mm
from handeye_fg.io.results import Result
from handeye_fg.report.wording import number, parameter_names

_HIGH = 0.8  # a correlation above which a person should know
_COMPONENTS = tuple(
    f"{kind} {axis}" for kind in ("the rotation about", "the position along") for axis in "xyz"
)


def ties(result: Result) -> tuple[str, ...]:
    """High correlations, each in a sentence; of several cameras with the name of each."""
    if not result.cameras:
        return tuple(_of_one(result))
    return tuple(
        f"{camera.name}: {sentence}" for camera in result.cameras for sentence in _of_one(camera)
    )


def none_tied(result: Result) -> str:
    """The sentence for a result without such; "" where there is one, or nothing is known of them."""
    if result.covariance is None or ties(result):
        return ""
    refined = any(one.intrinsics_refined for one in result.cameras or (result,))
    with_intrinsics = ", and those with the intrinsics," if refined else ""
    return f"Nothing: all correlations of the components of X{with_intrinsics} are below {_HIGH:g}."


def _of_one(camera: Calibrated) -> list[str]:
    said = [*_within(camera), *_with_intrinsics(camera)]
    offset = camera.focal_offset
    if offset is not None and abs(offset.correlation) >= _HIGH:
        said.append(
            f"Focal length and the position along the optical axis (correlation {number(offset.correlation, 2)}): "
            "an error of one is an error of the other; more tilt of the camera tells them apart."
        )
    return said


def _within(camera: Calibrated) -> list[str]:
    """Of the components of X with each other."""
    if camera.covariance is None:
        return []
    stds = (*std_rotation_deg(camera), *std_translation_mm(camera))
    known = [k for k, std in enumerate(stds) if std]
    covariance = camera.covariance.tolist()
    return [
        f"{_COMPONENTS[i].capitalize()} and {_COMPONENTS[j]} (correlation {number(value, 2)})."
        for i in known
        for j in known
        if i < j
        and abs(value := covariance[i][j] / math.sqrt(covariance[i][i] * covariance[j][j])) >= _HIGH
    ]


def _with_intrinsics(camera: Calibrated) -> list[str]:
    """Of these with the camera's parameters."""
    model, correlation = camera.camera, camera.intrinsics_correlation
    if model is None or correlation is None:
        return []
    names = parameter_names(model.model, len(model.params))
    return [
        f"The camera's {name} and {_COMPONENTS[j]} (correlation {number(value, 2)})."
        for name, row in zip(names, correlation.tolist(), strict=True)
        for j, value in enumerate(row)
        if abs(value) >= _HIGH
    ]

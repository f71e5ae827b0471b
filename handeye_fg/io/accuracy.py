"""The error that X causes, in ``result.json``: the key ``accuracy``."""

import numpy as np

from handeye_fg.io.fields import Fields
from handeye_fg.point_errors import Accuracy, PointError

Document = dict[str, object]
_MM = 1e3


def accuracy_document(accuracy: Accuracy) -> Document:
    """The content of the key ``accuracy``."""
    distance = accuracy.working_distance
    return {
        "working_distance_mm": None if distance is None else _MM * distance,
        "tolerance_mm": None if accuracy.tolerance is None else _MM * accuracy.tolerance,
        "tool": _point_document(accuracy.tool),
        "along_axis": [_point_document(error) for error in accuracy.along_axis],
    }


def read_accuracy(fields: Fields) -> Accuracy:
    """The errors from the content of the key ``accuracy``.

    Raises:
        InputDataError: it has not the form of one.
    """
    distance = fields.optional_number("working_distance_mm")
    tolerance = fields.optional_number("tolerance_mm")
    return Accuracy(
        working_distance=None if distance is None else distance / _MM,
        tool=_point(fields.mapping("tool")),
        along_axis=tuple(map(_point, fields.mappings("along_axis"))),
        tolerance=None if tolerance is None else tolerance / _MM,
    )


def _point_document(error: PointError) -> Document:
    return {
        "point_camera_m": error.point_camera.tolist(),
        "std_mm": (_MM * np.sqrt(np.diag(error.covariance))).tolist(),
        "covariance": error.covariance.tolist(),
        "within_95_mm": _MM * error.within_95,
    }


def _point(fields: Fields) -> PointError:
    return PointError(
        point_camera=fields.array("point_camera_m", (3,)),
        covariance=fields.array("covariance", (3, 3)),
        within_95=fields.number("within_95_mm") / _MM,
    )

"""The numbers of a pose file before a convention is put on them, and the poses that they give."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from handeye_fg.frames import Array, pose
from handeye_fg.io.poses.convention import Convention, to_poses
from handeye_fg.io.read_as import ReadAs
from handeye_fg.types import Indices, RobotPoses


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseRows:
    """What stands in a pose file.

    Attributes:
        source: the file, as the start of an error message.
        places: where each row stands, in the same way.
        positions: (n, 3) as they are written.
        rotations: (n, k) as they are written: quaternion, angles, or nine entries by rows.
        columns: of the rotation, for error messages; "" for a matrix.
        names: image names of the rows, or names of their files; None: there are none.
        file_names: whether the names are those of the rows' own files.
        times_ns: of the rows; None: there are none.
    """

    source: str
    places: tuple[str, ...]
    positions: Array
    rotations: Array
    columns: str
    names: tuple[str, ...] | None = None
    file_names: bool = False
    times_ns: Indices | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Partners:
    """Which rows give the pose of an image.

    Attributes:
        names: of the images (m,).
        before, after: rows (m,) before and after each image; the same where one row is the image's own.
        share: where between them the image is (m,), from 0 to 1.
    """

    names: tuple[str, ...]
    before: NDArray[np.intp]
    after: NDArray[np.intp]
    share: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseFile:
    """A pose file that has been read and paired; its poses under any convention.

    Attributes:
        read_as: its format, and what its numbers are claimed to mean, in words.
        convention: what its numbers are claimed to mean.
        rows: its numbers.
        partners: which of them belong to which image.
    """

    read_as: ReadAs
    convention: Convention
    rows: PoseRows
    partners: Partners

    def poses(self, convention: Convention | None = None) -> RobotPoses:
        """The robot poses by image name.

        Args:
            convention: what the numbers mean; None: what they are claimed to mean.

        Raises:
            InputDataError: a row is no pose under this convention.
        """
        rows = self.rows
        given = to_poses(
            rows.positions,
            rows.rotations,
            convention or self.convention,
            rows.places,
            rows.columns,
        )
        partners = self.partners
        return RobotPoses(
            names=partners.names,
            base_T_gripper=_between(given[partners.before], given[partners.after], partners.share),
        )


def _between(first: Array, second: Array, share: Array) -> Array:
    """Poses (m, 4, 4) on the way from one to the other: straight, and about one axis."""
    start, end = Rotation.from_matrix(first[:, :3, :3]), Rotation.from_matrix(second[:, :3, :3])
    turned = start * Rotation.from_rotvec(share[:, None] * (start.inv() * end).as_rotvec())
    moved = first[:, :3, 3] + share[:, None] * (second[:, :3, 3] - first[:, :3, 3])
    inside = share > 0.0  # the others keep their digits
    result = first.copy()
    result[inside] = pose(turned.as_matrix(), moved)[inside]
    return result

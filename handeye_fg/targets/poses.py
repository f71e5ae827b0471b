"""Camera poses from a known target (PnP), all in its frame; entry points ``board_poses``, ``place_on_board``."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from handeye_fg import frames
from handeye_fg.errors import InputDataError, ReconstructionError
from handeye_fg.frames import Array
from handeye_fg.intrinsics import covers_image, fitted_opencv, pinhole_view
from handeye_fg.patterns import Detections, Target, ambiguities, corners_target
from handeye_fg.progress import Progress, silent
from handeye_fg.targets.detect import FEWEST_CORNERS, find_target
from handeye_fg.targets.numbering import agreeing
from handeye_fg.types import CameraModel, Indices

# A plane fits from two sides: the other side stays possible where it fits less than this much worse.
_OTHER_SIDE = 2.0
# Corners farther from their prediction than this part of the image's width are those of another
# pattern: nominal intrinsics cost a tenth of it.
_WORST_RMS = 0.005
# Corners whose spread across is less than this part of their spread along lie on a line.
_LINE = 0.02
# Corners farther from their prediction are strays: of Gaussian ones 0.03 % are; the error of a corner
# is not taken to be smaller than the second figure (pixels), that of ideal images.
_STRAY_SIGMAS, _FINEST_PX = 4.0, 0.02
_NO_FIT = "the target's corners do not fit its pattern"
_UNDECIDED = (
    "the target looks the same from several sides, and the robot's motion does not tell which it is"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardPoses:
    """Camera poses from a known target.

    Attributes:
        detections: the corners they come from, with the same numbering in all images.
        target_T_camera: poses (n, 4, 4) of ``detections.names``, metres.
        rms_px: root mean square length (n,) of the reprojection errors, pixels.
        left_out: (image name, reason) of the images that show the target and have no pose.
    """

    detections: Detections
    target_T_camera: Array
    rms_px: Array
    left_out: tuple[tuple[str, str], ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The images (n,) that have a pose."""
        return self.detections.names


def board_poses(
    images: Path,
    names: Sequence[str],
    camera: CameraModel,
    target: Target,
    base_T_gripper: Array | None = None,
    progress: Progress = silent,
) -> BoardPoses:
    """Find a target in images and the camera poses from each image alone.

    Args:
        images: folder of the images.
        names: the images.
        camera: intrinsics.
        target: what to look for.
        base_T_gripper: robot poses (n, 4, 4) of ``names``, or their inverses; needed where the pattern
            looks the same when it is turned.
        progress: told "target".

    Raises:
        InputDataError: an image cannot be read, or an ambiguous pattern came without robot poses.
        ReconstructionError: no image shows the target, or it has another pattern.
    """
    detections = find_target(images, names, target.pattern, progress)
    if base_T_gripper is not None:
        row = {name: i for i, name in enumerate(names)}
        base_T_gripper = base_T_gripper[[row[name] for name in detections.names]]
    return place_on_board(detections, camera, target, base_T_gripper)


def place_on_board(
    detections: Detections, camera: CameraModel, target: Target, base_T_gripper: Array | None
) -> BoardPoses:
    """Camera poses from the corners of a target.

    Args:
        detections: the corners.
        camera: intrinsics.
        target: what was looked for.
        base_T_gripper: robot poses (n, 4, 4) of the detections' images, or their inverses; None for
            patterns that are not ambiguous.

    Raises:
        InputDataError: an ambiguous pattern came without robot poses.
        ReconstructionError: no image shows the target, or it has another pattern.
    """
    kind, numberings = target.pattern.kind, ambiguities(target.pattern)
    if base_T_gripper is None and len(numberings) > 1:
        raise InputDataError(
            f"a target of kind {kind} with these counts looks the same when it is turned, and "
            "without robot poses nothing tells how the images see it; give the robot poses"
        )
    view, pixels, _ = pinhole_view(_invertible(camera), detections.pixels)
    undistorted = replace(detections, pixels=pixels)
    corners = corners_target(target.pattern)
    turns = np.array([_turn(corners, corners[numbering]) for numbering in numberings])
    seen = [undistorted.of(i) for i in range(len(detections.names))]
    found = [_possible(corners[numbers], at, view) for numbers, at in seen]
    limit = _WORST_RMS * camera.width
    fits = np.array([len(one.errors) > 0 and one.errors[0] <= limit for one in found])
    if not fits.any():
        raise ReconstructionError(
            "the target in the images is not that of the target file: in none of the "
            f"{len(fits)} images that show it are its corners within {limit:.1f} px (root mean square) "
            "of where they should be; check the counts, the ratio of the lengths, and the intrinsics"
        )
    placed = np.flatnonzero(fits)
    candidates = [_turned(turns, found[i].target_T_camera) for i in placed]
    if base_T_gripper is None:  # without turns: the first is the best
        chosen, decided = np.zeros(len(placed), np.int64), np.ones(len(placed), dtype=bool)
    else:
        chosen, decided = agreeing(base_T_gripper[placed], candidates)
    reasons = dict.fromkeys(np.flatnonzero(~fits), _NO_FIT)
    reasons |= dict.fromkeys(placed[~decided], _UNDECIDED)
    kept = np.flatnonzero(decided)
    sides = [divmod(int(chosen[k]), len(found[placed[k]].errors)) for k in kept]
    return BoardPoses(
        detections=_renumbered(
            detections,
            [(int(placed[k]), numberings[turn]) for k, (turn, _) in zip(kept, sides, strict=True)],
        ),
        target_T_camera=np.array([candidates[k][chosen[k]] for k in kept]).reshape(-1, 4, 4),
        rms_px=np.array(
            [found[placed[k]].errors[side] for k, (_, side) in zip(kept, sides, strict=True)]
        ),
        left_out=tuple((detections.names[i], reason) for i, reason in sorted(reasons.items())),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Possible:
    """Poses from which an image may have been taken, best first.

    Attributes:
        errors: root mean square (h,) in pixels.
        target_T_camera: (h, 4, 4).
    """

    errors: Array
    target_T_camera: Array


def _turn(corners: Array, turned: Array) -> Array:
    """The motion (4, 4) that carries the corners (k, 3) of a target to others of them."""
    middle = corners.mean(axis=0)
    rotation = frames.orthonormalised((turned - middle).T @ (corners - middle))
    return frames.pose(rotation, middle - rotation @ middle)


def _turned(turns: Array, target_T_camera: Array) -> Array:
    """Poses (r * h, 4, 4): for each of the turns (r, 4, 4) all poses (h, 4, 4)."""
    return np.asarray((turns[:, None] @ target_T_camera[None]).reshape(-1, 4, 4))


def _invertible(camera: CameraModel) -> CameraModel:
    """The camera, or the nearest one whose every pixel has a line of sight."""
    return camera if covers_image(camera) else fitted_opencv(camera)[0]


def _possible(corners: Array, pixels: Array, view: CameraModel) -> _Possible:
    """Poses from which a plane looks as in the image: the best, and the other side where it fits too.

    Args:
        corners: positions (c, 3) in the target frame.
        pixels: where they are seen (c, 2).
        view: a PINHOLE camera.

    There is none where the corners lie on a line.
    """
    spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
    if spread[1] < _LINE * spread[0]:
        return _Possible(errors=np.empty(0), target_T_camera=np.empty((0, 4, 4)))
    K = np.diag([*view.params[:2], 1.0])
    K[:2, 2] = view.params[2:]
    _, rotations, translations, _ = cv2.solvePnPGeneric(
        corners, pixels, K, None, flags=cv2.SOLVEPNP_IPPE
    )
    found = [
        _without_strays(
            corners, pixels, K, np.asarray(rotation, float), np.asarray(translation, float)
        )
        for rotation, translation in zip(rotations, translations, strict=True)
    ]
    found.sort(key=lambda pair: pair[0])
    fitting = [pair for pair in found if pair[0] <= _OTHER_SIDE * found[0][0]]
    return _Possible(
        errors=np.array([error for error, _ in fitting]),
        target_T_camera=np.array([pose for _, pose in fitting]),
    )


def _without_strays(
    corners: Array, pixels: Array, K: Array, rotation: Array, translation: Array
) -> tuple[float, Array]:
    """Refine a pose, leave out strays (corners that were located somewhere else), refine it again.

    Returns:
        Error (root mean square, pixels) of the corners that were used, and target_T_camera (4, 4).
    """
    used = np.ones(len(corners), dtype=bool)
    length = np.zeros(len(corners))
    for _ in range(2):
        r, t = cv2.solvePnPRefineLM(corners[used], pixels[used], K, None, rotation, translation)
        rotation, translation = np.asarray(r, float), np.asarray(t, float)
        predicted, _ = cv2.projectPoints(corners, rotation, translation, K, None)
        error = predicted.reshape(-1, 2) - pixels
        length = np.linalg.norm(error, axis=1)
        near = length <= _STRAY_SIGMAS * max(1.4826 * np.median(np.abs(error)), _FINEST_PX)
        if np.count_nonzero(near & used) < FEWEST_CORNERS:
            break
        used &= near
    camera_T_target = frames.pose(np.asarray(cv2.Rodrigues(rotation)[0]), translation.ravel())
    return float(np.sqrt(np.mean(length[used] ** 2))), frames.inverse(camera_T_target)


def _renumbered(detections: Detections, numbering: Sequence[tuple[int, Indices]]) -> Detections:
    """The corners of some images: (image, new number (k,) of each corner)."""
    corners, pixels = [np.empty(0, np.int64)], [np.empty((0, 2))]
    for i, new in numbering:
        numbers, seen = detections.of(i)
        corners.append(new[numbers])
        pixels.append(seen)
    counts = [len(numbers) for numbers in corners[1:]]
    return Detections(
        names=tuple(detections.names[i] for i, _ in numbering),
        image_index=np.repeat(np.arange(len(counts)), counts),
        corner=np.concatenate(corners),
        pixels=np.concatenate(pixels),
    )

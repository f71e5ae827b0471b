"""A known target and a reconstruction in one frame, that of the target; entry point ``on_target``."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.patterns import Target, corners_target
from handeye_fg.targets.poses import BoardPoses
from handeye_fg.types import CameraModel, KnownPoints, SfmModel, Tracks

FEWEST_SHARED = 3
"""Images with both poses that place a reconstruction in the target's frame."""

# An image is placed wrongly, by the reconstruction or by the target, where its poses differ by more.
# The pose from a small board with nominal intrinsics is good to a degree or two.
_SAME_ROTATION = np.deg2rad(5.0)
_SAME_POSITION = 0.1  # of the distance to the target
# With fewer images than this part in agreement it is the reconstruction as a whole that is false.
_MAJORITY = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Similarity:
    """``p_target = scale * rotation p_world + translation``."""

    rotation: Array
    translation: Array
    scale: float

    def points(self, points_world: Array) -> Array:
        """Points (p, 3) in the target frame."""
        return np.asarray(self.scale * points_world @ self.rotation.T + self.translation)

    def poses(self, world_T_camera: Array) -> Array:
        """Poses (n, 4, 4) in the target frame."""
        return frames.pose(
            self.rotation @ world_T_camera[:, :3, :3], self.points(world_T_camera[:, :3, 3])
        )


def on_target(
    model: SfmModel | None, board: BoardPoses, target: Target, camera: CameraModel
) -> tuple[SfmModel, KnownPoints]:
    """One model in the target's frame and metres, the target's corners its first points.

    Images that both place keep the reconstruction's pose, which more points hold, unless the two
    disagree: then the target's pose stands, without the image's scene points. A reconstruction that
    disagrees in most images is left out.

    Args:
        model: the reconstruction; None where there is none.
        board: camera poses from the target.
        target: the target.
        camera: intrinsics where there is no reconstruction.
    """
    corners = corners_target(target.pattern)
    extent = float(np.linalg.norm(np.ptp(corners, axis=0)))
    known = KnownPoints(
        points_world=corners,
        sigma=target.accuracy_m,
        log_scale_sigma=target.accuracy_m / extent,
    )
    placed = None if model is None else _aligned(model, board)
    if model is None or placed is None:
        return _board_model(board, corners, camera, model), known
    similarity, wrong = placed
    return _joined(model, board, corners, similarity, wrong), known


def _aligned(model: SfmModel, board: BoardPoses) -> tuple[_Similarity, set[str]] | None:
    """The similarity to the target's frame, and the images (names) that disagree with it."""
    shared = [name for name in model.names if name in board.names]
    if len(shared) < FEWEST_SHARED:
        return None
    sfm = model.world_T_camera[[model.names.index(name) for name in shared]]
    pnp = board.target_T_camera[[board.names.index(name) for name in shared]]
    turns = pnp[:, :3, :3] @ np.swapaxes(sfm[:, :3, :3], 1, 2)
    apart = frames.rotation_angle(
        (np.swapaxes(turns[:, None], 2, 3) @ turns[None]).reshape(-1, 3, 3)
    ).reshape(len(shared), -1)
    # The image that most others agree with: its half of the images gives the first similarity.
    agree = apart[np.median(apart, axis=1).argmin()] <= _SAME_ROTATION
    least = max(FEWEST_SHARED, _MAJORITY * len(shared))
    if np.count_nonzero(agree) < least:
        return None
    similarity = _similarity(sfm[agree], pnp[agree], turns[agree])
    agree = _same(similarity.poses(sfm), pnp)
    if similarity.scale <= 0.0 or np.count_nonzero(agree) < least:  # a world turned inside out
        return None
    similarity = _similarity(sfm[agree], pnp[agree], turns[agree])
    return similarity, {name for name, same in zip(shared, agree, strict=True) if not same}


def _similarity(sfm: Array, pnp: Array, turns: Array) -> _Similarity:
    """The similarity that best carries poses (n, 4, 4) to others, rotations by their mean ``turns``."""
    rotation = frames.orthonormalised(turns.mean(axis=0))
    source, wanted = sfm[:, :3, 3] @ rotation.T, pnp[:, :3, 3]
    centred = source - source.mean(axis=0)
    scale = float(np.sum(centred * (wanted - wanted.mean(axis=0))) / np.sum(centred**2))
    translation = wanted.mean(axis=0) - scale * source.mean(axis=0)
    return _Similarity(rotation=rotation, translation=translation, scale=scale)


def _same(poses: Array, others: Array) -> NDArray[np.bool_]:
    """Which of the poses (n, 4, 4) in the target's frame agree."""
    difference = frames.inverse(poses) @ others
    turned = frames.rotation_angle(difference[:, :3, :3])
    moved = np.linalg.norm(difference[:, :3, 3], axis=1)
    distance = np.linalg.norm(others[:, :3, 3], axis=1)
    return np.asarray((turned <= _SAME_ROTATION) & (moved <= _SAME_POSITION * distance))


def _board_model(
    board: BoardPoses, corners: Array, camera: CameraModel, model: SfmModel | None
) -> SfmModel:
    """The target alone."""
    reasons = dict(board.left_out)
    if model is not None:
        reasons = dict.fromkeys(model.names, _FALSE) | dict(model.unregistered) | reasons
    return SfmModel(
        names=board.names,
        world_T_camera=board.target_T_camera,
        cameras=(camera,),
        image_camera=np.zeros(len(board.names), dtype=np.int64),
        tracks=Tracks(
            points_world=corners,
            image_index=board.detections.image_index,
            point_index=board.detections.corner,
            pixels=board.detections.pixels,
        ),
        mean_reprojection_px=float(np.mean(board.rms_px)),
        unregistered=tuple((n, reason) for n, reason in reasons.items() if n not in board.names),
    )


_FALSE = "the target was not found in it, and the reconstruction disagrees with the target"


def _joined(
    model: SfmModel, board: BoardPoses, corners: Array, similarity: _Similarity, wrong: set[str]
) -> SfmModel:
    """The target's corners and the scene's points."""
    from_model = [name for name in model.names if name not in wrong]
    names = tuple(sorted({*from_model, *board.names}))
    row = {name: i for i, name in enumerate(names)}
    world_T_camera = np.empty((len(names), 4, 4))
    for name, pose in zip(board.names, board.target_T_camera, strict=True):
        world_T_camera[row[name]] = pose
    in_target = similarity.poses(model.world_T_camera)
    for name in from_model:
        world_T_camera[row[name]] = in_target[model.names.index(name)]

    scene, seen = model.tracks, board.detections
    used = np.array([name not in wrong for name in model.names])[scene.image_index]
    scene_rows = np.array([row.get(name, -1) for name in model.names])
    board_rows = np.array([row[name] for name in board.names])
    return SfmModel(
        names=names,
        world_T_camera=world_T_camera,
        cameras=model.cameras,
        image_camera=np.zeros(len(names), dtype=np.int64),
        tracks=Tracks(
            points_world=np.concatenate([corners, similarity.points(scene.points_world)]),
            image_index=np.concatenate(
                [board_rows[seen.image_index], scene_rows[scene.image_index[used]]]
            ),
            point_index=np.concatenate([seen.corner, scene.point_index[used] + len(corners)]),
            pixels=np.concatenate([seen.pixels, scene.pixels[used]]),
        ),
        mean_reprojection_px=model.mean_reprojection_px,
        unregistered=tuple((n, reason) for n, reason in model.unregistered if n not in row),
    )

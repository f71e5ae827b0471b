"""The pairs of images that are worth matching, by the robot's poses; entry point ``match_by_robot``.

A few images are matched and mapped first, of each camera by itself: two on one arm may share nothing. From
them follow X and the scale, so that the robot says where every camera was, and what it should see. Where
images do not show what they should, the robot's poses may be wrong: such an image is matched with all others.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.options import SfmOptions
from handeye_fg.overlap import best_partners, expected_matches
from handeye_fg.sfm.guided import turns_of_pairs
from handeye_fg.sfm.matching import Matcher
from handeye_fg.types import Indices, SfmModel, folder_of

# Below, all pairs take no longer than the choice of some.
_MOST_FOR_ALL = 30
# Images to begin with; others to match an image with. With 8 others X is the same as with all 59.
_BEGINNING, _PARTNERS = 16, 10
# Poses that are this near, in parts of the usual distance, are one.
_SAME = 1e-6
# COLMAP's least number of inliers of a pair.
_FEWEST_MATCHES = 15
# Two views of a small or flat object give their turn to some degrees.
_WITHIN = np.deg2rad(4.0)
# More images than this part that are not where the robot says: the robot's poses are of no use.
_MOST_DOUBTFUL = 1.0 / 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotGuide:
    """What the robot knows of where the images were taken.

    Attributes:
        base_T_gripper: the reported poses (n, 4, 4) of the images in the order of their names, in the form
            of the equations.
        place: from models of some images the models in one world, and camera poses (n, 4, 4) of all images
            there; None: robot and models do not agree well enough, or they have no image of some camera.
    """

    base_T_gripper: Array
    place: Callable[[Sequence[SfmModel]], tuple[SfmModel, Array] | None]


def by_robot(options: SfmOptions, n_images: int) -> bool:
    """Whether the robot is to say which pairs are matched."""
    return options.pairs == "robot" or (options.pairs == "auto" and n_images > _MOST_FOR_ALL)


def match_by_robot(
    matcher: Matcher,
    names: tuple[str, ...],
    guide: RobotGuide,
    map_some: Callable[[int, tuple[str, ...]], SfmModel | None],
) -> tuple[str, ...]:
    """Match the pairs of images that should see the same things, or all where that is not known.

    Args:
        matcher: of a database with the features of the images.
        names: of all images, in their order.
        guide: what the robot knows.
        map_some: the model of some of the images from the matches so far, and which of several models it is.

    Returns:
        The images of which the first model agreed with the robot, so that it chose the pairs; none: all were
        matched.

    Raises:
        ReconstructionError: COLMAP failed.
    """
    for beginning in beginnings(guide.base_T_gripper, [folder_of(name) for name in names]):
        begun = [tuple(names[i] for i in images.tolist()) for images in beginning]
        models = []
        for k, images in enumerate(beginning):
            matcher.match_pairs(_all_pairs(images))
            models.append(map_some(k, begun[k]))
        found = [model for model in models if model is not None]
        placed = guide.place(found) if len(found) == len(models) else None
        if placed is None:
            continue
        model, world_T_camera = placed
        of_folder = dict(zip(map(folder_of, model.names), model.image_camera.tolist(), strict=True))
        camera = np.array([of_folder[folder_of(name)] for name in names])
        features = _features(matcher.database, len(names))
        expected = expected_matches(model, world_T_camera, model.cameras, camera, features)
        chosen = best_partners(expected, _PARTNERS)
        matcher.match_pairs(_pairs(chosen))
        doubtful = not_as_placed(matcher.database, chosen, world_T_camera, matcher.seed)
        if np.mean(doubtful) <= _MOST_DOUBTFUL:
            matcher.match_pairs(_pairs(doubtful | doubtful[:, None]))
            return begun[0]
        break
    matcher.match_all()
    return ()


def beginnings(base_T_gripper: Array, folders: Sequence[str]) -> Iterator[tuple[Indices, ...]]:
    """Sets of images to begin with, each to be mapped by itself, in the order in which they are to be tried.

    First of each camera some that are spread over the half in the middle: they tell X well, and are near
    enough to each other to be matched. Then those that are nearest to each other. Then both of all cameras
    together, in case that one has too few images by itself; images at one pose come together.

    Args:
        base_T_gripper: the reported poses (n, 4, 4).
        folders: of each image: those in one are of one camera.
    """
    of_cameras = [np.flatnonzero(np.array(folders) == folder) for folder in sorted({*folders})]
    together = [np.arange(len(folders))]
    for groups in [of_cameras] + [together] * (len(of_cameras) > 1):
        for chosen in (_spread, _compact):
            yield tuple(group[chosen(_apart(base_T_gripper[group]))] for group in groups)


def _spread(apart: Array) -> Indices:
    """Images that are spread over the half in the middle; ``apart``: how far they are from each other (n, n)."""
    by_nearness = _by_nearness(apart)
    half = by_nearness[: max(_BEGINNING, (len(apart) + 1) // 2)]
    spread = half[:1]
    while True:
        to_spread = apart[spread].min(axis=0)
        chosen = np.flatnonzero(to_spread < _SAME)
        if len(chosen) >= _BEGINNING or np.all(to_spread[half] < _SAME):
            return chosen
        spread = np.append(spread, half[np.argmax(to_spread[half])])


def _compact(apart: Array) -> Indices:
    """The images that are nearest to each other."""
    return np.sort(_by_nearness(apart)[:_BEGINNING])


def _by_nearness(apart: Array) -> Indices:
    """The images (n,), the most central one first."""
    return np.argsort(apart[np.argmin(apart.sum(axis=1))], kind="stable")


def _features(database: Path, n_images: int) -> list[Array]:
    """Pixels (f, 2) of the features of each image."""
    with pycolmap.Database.open(database) as db:
        return [
            np.asarray(db.read_keypoints(number)[:, :2], dtype=np.float64)
            for number in range(1, n_images + 1)
        ]


def not_as_placed(
    database: Path, chosen: NDArray[np.bool_], world_T_camera: Array, seed: int
) -> NDArray[np.bool_]:
    """The images (n,) of which fewer pairs agree with the cameras' poses than do not.

    Args:
        database: with the chosen pairs matched.
        chosen: which pairs (n, n) were expected to match.
        world_T_camera: the camera poses (n, 4, 4).
        seed: of the sample, where there are very many pairs.
    """
    with pycolmap.Database.open(database) as db:
        pair_ids, inliers = db.read_two_view_geometry_num_inliers()
        several = db.num_cameras() > 1
    found = np.zeros(chosen.shape)
    for pair_id, n in zip(pair_ids, inliers, strict=True):
        first, second = pycolmap.pair_id_to_image_pair(pair_id)
        found[first - 1, second - 1] = found[second - 1, first - 1] = n
    verified = chosen & (found >= _FEWEST_MATCHES)
    right, wrong = verified.sum(axis=1), (chosen & ~verified).sum(axis=1)
    if not several:
        pairs = turns_of_pairs(database, seed)
        R = world_T_camera[:, :3, :3]
        expected = np.swapaxes(R[pairs.i], 1, 2) @ R[pairs.j]
        off = frames.rotation_angle(np.swapaxes(expected, 1, 2) @ pairs.camera) > _WITHIN
        astray = np.zeros(chosen.shape, dtype=bool)
        astray[pairs.i[off], pairs.j[off]] = astray[pairs.j[off], pairs.i[off]] = True
        n_astray = (astray & verified).sum(axis=1)
        right, wrong = right - n_astray, wrong + n_astray
    return np.asarray(right < wrong)


def _apart(poses: Array) -> Array:
    """How far poses are from each other (n, n): turns and ways in parts of the usual ones."""
    R, t = poses[:, :3, :3], poses[:, :3, 3]
    turns = frames.rotation_angle(np.swapaxes(R, 1, 2)[:, None] @ R)
    ways = np.linalg.norm(t[:, None] - t, axis=2)
    return np.asarray(sum(d / max(float(np.median(d)), 1e-12) for d in (turns, ways)))


def _all_pairs(images: Indices) -> Indices:
    """All pairs (k, 2) of some images."""
    i, j = np.triu_indices(len(images), 1)
    return np.column_stack([images[i], images[j]])


def _pairs(chosen: NDArray[np.bool_]) -> Indices:
    """The pairs (k, 2) of a symmetric matrix."""
    return np.argwhere(np.triu(chosen, 1))

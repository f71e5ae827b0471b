"""Pairs of images held against the robot: right ones told from look-alikes; ``turns_of_pairs``, ``keep``.

Where a texture repeats, on the sides of an object above all, sides are taken for one another: each such
pair of images looks right, and a reconstruction from them is wrong. The robot tells them apart, since
the camera turns as it does.
"""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap

from handeye_fg.frames import Array
from handeye_fg.sfm.model import FEWEST_IMAGES
from handeye_fg.turns import RobotTurns, agreement, pose_agreement
from handeye_fg.types import Fragment, Indices

# COLMAP's least number of inliers of a pair.
_FEWEST_MATCHES = 15
# More pairs add time and no certainty.
_MOST_PAIRS = 2000
# A setup is another one if so many times more pairs agree with it.
_CLEARLY = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairTurns:
    """Verified pairs of images, and how the camera turned between them.

    Attributes:
        ids: COLMAP's numbers (k, 2) of the images.
        i: index (k,) of the first image in the order of the robot's turns.
        j: index (k,) of the second.
        camera: turns (k, 3, 3) of the camera.
    """

    ids: Indices
    i: Indices
    j: Indices
    camera: Array


def turns_of_pairs(database: Path, seed: int) -> PairTurns:
    """The turns of a database's verified pairs, of very many pairs those of a sample.

    Several cameras do not share an R_X: of their images there are none.
    """
    with pycolmap.Database.open(database) as db:
        numbers = sorted(image.image_id for image in db.read_all_images())
        index = {number: k for k, number in enumerate(numbers)}
        camera, *others = db.read_all_cameras()
        pair_ids, inliers = db.read_two_view_geometry_num_inliers()
        pairs = [
            pycolmap.pair_id_to_image_pair(pair)
            for pair, n in zip(pair_ids, inliers, strict=True)
            if n >= _FEWEST_MATCHES and not others
        ]
        if len(pairs) > _MOST_PAIRS:
            chosen = np.random.default_rng(seed).choice(len(pairs), _MOST_PAIRS, replace=False)
            pairs = [pairs[k] for k in np.sort(chosen)]
        places = {
            number: np.asarray(db.read_keypoints(number)[:, :2], dtype=np.float64)
            for number in {number for pair in pairs for number in pair}
        }
        ids, turns = [], []
        for first, second in pairs:
            geometry = db.read_two_view_geometry(first, second)
            posed = pycolmap.estimate_two_view_geometry_pose(
                camera, places[first], camera, places[second], geometry
            )
            if posed and geometry.cam2_from_cam1 is not None:
                ids.append((first, second))
                turns.append(geometry.cam2_from_cam1.rotation.matrix().T)
    return PairTurns(
        ids=np.array(ids, dtype=np.int64).reshape(-1, 2),
        i=np.array([index[first] for first, _ in ids], dtype=np.int64),
        j=np.array([index[second] for _, second in ids], dtype=np.int64),
        camera=np.array(turns).reshape(-1, 3, 3),
    )


def likelier_turns(database: Path, turns: RobotTurns, seed: int) -> RobotTurns:
    """The robot's turns as they are said to be, or of the other setup, whichever more pairs agree with.

    Which of them is right is judged when there is a model; here wrong ones would be in the way of it.
    """
    pairs = turns_of_pairs(database, seed)
    other = turns.inverted()
    given, inverse = (
        agreement(each.between(pairs.i, pairs.j), pairs.camera, seed) for each in (turns, other)
    )
    clearly = inverse.agrees.sum() >= _CLEARLY * max(1, given.agrees.sum())
    return other if inverse.significant and clearly else turns


def agreeing_pairs(database: Path, copy: Path, turns: RobotTurns, seed: int) -> bool:
    """Copy a database without the pairs that turn otherwise than the robot.

    Args:
        database: with verified pairs.
        copy: file to write.
        turns: of the robot.
        seed: of the samples.

    Returns:
        Whether there is one: not where no more pairs agree with the robot than would by chance.
    """
    pairs = turns_of_pairs(database, seed)
    found = agreement(turns.between(pairs.i, pairs.j), pairs.camera, seed)
    if not found.significant:
        return False
    right = {(first, second) for first, second in pairs.ids[found.agrees].tolist()}
    shutil.copyfile(database, copy)
    with pycolmap.Database.open(copy) as db:
        for pair in db.read_two_view_geometry_num_inliers()[0]:
            first, second = pycolmap.pair_id_to_image_pair(pair)
            if (first, second) not in right:
                db.delete_two_view_geometry(first, second)
    return True


def model_agreement(
    fragments: Sequence[Fragment], names: Sequence[str], turns: RobotTurns
) -> float:
    """Part of all pairs of images that the fragments place so that the camera turned as the robot did.

    Pairs of images in different fragments, which the robot can join, count as those in one do on average.

    Args:
        fragments: of one reconstruction.
        names: names of all images, in the order of the turns.
        turns: of the robot.
    """
    placed = {name for fragment in fragments for name in fragment.names}
    if len(placed) < FEWEST_IMAGES:
        return 0.0
    row = {name: k for k, name in enumerate(names)}
    parts = [(np.array([row[n] for n in one.names]), one.world_T_camera) for one in fragments]
    return (len(placed) / len(names)) ** 2 * pose_agreement(turns, parts)

"""Features that stay where they are in the image while the robot turns; entry point ``drop_static``.

The background of a static camera, text drawn over the images, and the gripper in view of a camera that
it carries: each of them tells COLMAP that nothing moved, and outnumbers what did.
"""

from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray
from scipy.spatial import KDTree

from handeye_fg.frames import Array, rotation_angle
from handeye_fg.turns import RobotTurns

# What turns by this much moves by 90 px and more in the usual image, but for the point it turns about.
_TURN = np.deg2rad(10.0)
_NEAR_PX = 1.5
# Of 512, the length of a descriptor. Of two features that happen to lie at the same pixel three pairs in
# a thousand are nearer (more where a texture repeats), of the same thing seen twice four in five.
_ALIKE = 250.0
# Chance repeats a feature in one other image out of a hundred times, in three hardly ever. Where more than
# this part is in three, the rest of what lies still is not found that often, but more likely than chance.
_REPEATS, _PLENTY = 3, 0.1
# Other images to compare with; more would take long in large sets and tell the same.
_PARTNERS = 20


def drop_static(database: Path, turns: RobotTurns) -> float:
    """Take the features out of a database that stay at their pixel while the robot turns.

    Args:
        database: features without matches; its images in the order of the turns.
        turns: of the robot.

    Returns:
        Part of the features that were taken out.
    """
    with pycolmap.Database.open(database) as db:
        ids = sorted(image.image_id for image in db.read_all_images())
        places = [np.asarray(db.read_keypoints(i), dtype=np.float32) for i in ids]
        descriptors = [db.read_descriptors(i) for i in ids]
        static = static_features(
            [np.asarray(place[:, :2], dtype=np.float64) for place in places],
            [descriptor.data for descriptor in descriptors],
            turns,
        )
        dropped = [int(which.sum()) for which in static]
        if not any(dropped):
            return 0.0
        db.clear_keypoints()
        db.clear_descriptors()
        for i, place, descriptor, which in zip(ids, places, descriptors, static, strict=True):
            db.write_keypoints(i, place[~which])
            kept = pycolmap.FeatureDescriptors(descriptor.type, descriptor.data[~which])
            db.write_descriptors(i, kept)
    return sum(dropped) / sum(map(len, places))


def static_features(
    places: list[Array], descriptors: list[NDArray[np.uint8]], turns: RobotTurns
) -> list[NDArray[np.bool_]]:
    """Which features of each image are at the same pixel in images between which the robot turned.

    Args:
        places: pixels (f, 2) of the features of each image.
        descriptors: SIFT descriptors (f, 128) of the same.
        turns: of the robot, image by image.
    """
    trees = [KDTree(place) for place in places]
    repeats, needed = [], []
    for i, place in enumerate(places):
        turned = rotation_angle(np.swapaxes(turns.rotations[i : i + 1], 1, 2) @ turns.rotations)
        partners = np.argsort(-turned, kind="stable")[:_PARTNERS]
        partners = partners[turned[partners] > _TURN]
        times = np.zeros(len(place), dtype=np.int64)
        for j in partners.tolist():
            distance, nearest = trees[j].query(place, distance_upper_bound=_NEAR_PX)
            near = np.flatnonzero(np.isfinite(distance))
            apart = descriptors[i][near].astype(np.float32) - descriptors[j][nearest[near]]
            times[near] += np.linalg.norm(apart, axis=1) < _ALIKE
        repeats.append(times)
        needed.append(max(2, min(_REPEATS, len(partners))))
    surely = sum(int(np.sum(times >= n)) for times, n in zip(repeats, needed, strict=True))
    plenty = surely > _PLENTY * sum(map(len, repeats))
    return [times >= (1 if plenty else n) for times, n in zip(repeats, needed, strict=True)]

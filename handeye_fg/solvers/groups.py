"""Absolute poses, or motions chained into poses: independent residuals for least squares.

Residuals of motions that share a pose repeat its noise; those of absolute poses are independent.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.motions import MotionPairs, PosePairs, with_weight
from handeye_fg.types import Indices


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseGroups:
    """Poses in groups; each group has a base and a world of its own, at its centre.

    Attributes:
        base_T_gripper: (n, 4, 4), metres.
        world_T_camera: (n, 4, 4), world units.
        weights: (n,), of the squared residuals; their mean is 1.
        group: (n,), number of the pose's group, from 0.
    """

    base_T_gripper: Array
    world_T_camera: Array
    weights: Array
    group: Indices

    @property
    def count(self) -> int:
        """Number of groups."""
        return int(self.group.max()) + 1

    def total(self, values: Array) -> Array:
        """Sums (g, ...) over the poses (n, ...) of each group."""
        result = np.zeros((self.count, *values.shape[1:]))
        np.add.at(result, self.group, values)
        return result


def grouped(data: PosePairs | MotionPairs) -> PoseGroups:
    """The data as poses, without those of weight 0.

    Motions are chained along the spanning tree of their poses that has the largest weights: what
    hangs together is one group. The motions left over repeat what the chain says.
    """
    if isinstance(data, PosePairs):
        weights = np.asarray(data.weights)
        used = weights > 0.0
        one_group = np.zeros(int(used.sum()), dtype=np.int64)
        return _centred(
            data.base_T_gripper[used], data.world_T_camera[used], weights[used], one_group
        )
    pairs = with_weight(data)
    weights = np.asarray(pairs.weights)
    nodes, ends = np.unique(np.stack([pairs.i, pairs.j]), return_inverse=True)
    n, (i, j) = len(nodes), ends.reshape(2, -1)
    best = {
        (min(a, b), max(a, b)): k
        for k, a, b in sorted(
            zip(range(len(pairs)), i.tolist(), j.tolist(), strict=True),
            key=lambda row: weights[row[0]],
        )
    }
    low, high = np.array(list(best)).T
    cost = 1.0 + 1.0 / weights[list(best.values())]
    tree = csgraph.minimum_spanning_tree(sparse.coo_array((cost, (low, high)), shape=(n, n)))
    _, group = csgraph.connected_components(tree, directed=False)
    robot, camera = np.tile(np.eye(4), (2, n, 1, 1))
    for root in np.unique(group, return_index=True)[1].tolist():
        order, before = csgraph.breadth_first_order(tree, root, directed=False)
        for b in order[1:].tolist():
            a = int(before[b])
            k = best[min(a, b), max(a, b)]
            A, B = pairs.gi_T_gj[k], pairs.ci_T_cj[k]
            if i[k] == b:
                A, B = frames.inverse(A), frames.inverse(B)
            robot[b], camera[b] = robot[a] @ A, camera[a] @ B
    # The weight of a motion is the product of its poses': a pose's is the mean of its motions'.
    touched = np.concatenate([i, j])
    mean_weight = np.bincount(touched, np.tile(weights, 2)) / np.bincount(touched)
    return _centred(robot, camera, mean_weight, np.asarray(group, dtype=np.int64))


def _centred(robot: Array, camera: Array, weights: Array, group: Indices) -> PoseGroups:
    """Poses with the origins of each group's frames at its centre, where rounding is least."""
    count = np.bincount(group)[:, None]
    moved = []
    for poses in (robot, camera):
        centre = np.stack([np.bincount(group, axis) for axis in poses[:, :3, 3].T], axis=1) / count
        moved.append(frames.pose(poses[:, :3, :3], poses[:, :3, 3] - centre[group]))
    return PoseGroups(
        base_T_gripper=moved[0],
        world_T_camera=moved[1],
        weights=weights / weights.mean(),
        group=group,
    )

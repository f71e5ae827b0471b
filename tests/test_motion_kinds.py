"""The kinds of motion sets, without noise and with it."""

import numpy as np
import pytest

from handeye_fg.frames import Array, exp, pose
from handeye_fg.motion_kinds import classify
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.simulate import disturbed

ROTATION_NOISE, TRANSLATION_NOISE = 3e-4, 1e-4


def gripper_poses(kind: str, rng: np.random.Generator, n: int = 10) -> Array:
    turns, positions = np.zeros((n, 6)), rng.uniform(-0.2, 0.2, (n, 3))
    if kind in ("general", "rotations"):
        turns[:, :3] = rng.uniform(-0.6, 0.6, (n, 3))
    if kind in ("planar", "scara", "one axis", "mixed"):
        turns[:, 2] = rng.uniform(-2.0, 2.0, n)
    if kind == "planar":
        positions[:, 2] = 0.0
    if kind in ("rotations", "one axis", "none"):
        positions[:] = 0.0
    if kind == "mixed":
        positions[: n // 2] = 0.0
    base, tool = exp(rng.uniform(-1.0, 1.0, (2, 6)))
    tool[:3, 3] = 0.0
    return np.asarray(base @ pose(exp(turns)[:, :3, :3], positions) @ tool)


KINDS = {
    "none": ("none", 0),
    "translations": ("translations", 0),
    "rotations": ("rotations", 2),
    "one axis": ("rotations", 1),
    "planar": ("planar", 1),
    "scara": ("general", 1),
    "general": ("general", 2),
    "mixed": ("mixed", 1),
}


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_kinds(name: str, noise: float) -> None:
    right = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        poses = gripper_poses(name, rng)
        poses = disturbed(rng, poses, noise * ROTATION_NOISE, noise * TRANSLATION_NOISE)
        data = PosePairs(base_T_gripper=poses, world_T_camera=poses)
        found = classify(data, rotation_noise=ROTATION_NOISE, translation_noise=TRANSLATION_NOISE)
        right += (found.kind, found.n_axes) == KINDS[name]
        assert found.axes.shape == (3, found.n_axes)
    assert right >= 99


def test_the_axis_is_in_the_gripper_frame() -> None:
    axis = np.array([0.6, 0.0, 0.8])
    motion = exp(np.concatenate([axis, np.zeros(3)]))
    one = MotionPairs(i=np.array([0]), j=np.array([1]), gi_T_gj=motion[None], ci_T_cj=motion[None])
    np.testing.assert_allclose(np.abs(classify(one).axes[:, 0] @ axis), 1.0)

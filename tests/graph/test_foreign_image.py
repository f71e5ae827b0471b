"""An image of something else, which a false match or two placed anywhere, among those of several cameras."""

from dataclasses import replace

import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.graph import start_state
from handeye_fg.simulate import RigScene, simulate_rig
from handeye_fg.simulate.scenes import project
from handeye_fg.solvers.rig import rig_start
from handeye_fg.types import Rig, SfmModel
from refinements import refined_from

N_POSES = 10
# Off by 24 degrees and a sixth of the distance.
ELSEWHERE = np.array([0.1, 0.1, -0.4])


def with_foreign(scene: RigScene, n_points: int, rng: np.random.Generator) -> SfmModel:
    """The model with its last image elsewhere, where so many points of the scene seem to be seen."""
    model, tracks = scene.scene.model, scene.scene.model.tracks
    last, poses = len(model.names) - 1, np.array(model.world_T_camera)
    middle = tracks.points_world.mean(axis=0)
    distance = np.linalg.norm(poses[last, :3, 3] - middle)
    poses[last] = poses[last] @ frames.exp(np.append(ELSEWHERE, np.zeros(3)))
    poses[last, :3, 3] += 0.1 * distance * np.array([1.0, -1.0, 0.5])
    pixels = project(
        scene.scene.camera, (tracks.points_world - poses[last, :3, 3]) @ poses[last, :3, :3]
    )
    inside = np.flatnonzero(((pixels > 0.0) & (pixels < [1280.0, 960.0])).all(axis=1))
    seen = rng.choice(inside, n_points, replace=False)
    others = tracks.image_index != last
    return replace(
        model,
        world_T_camera=poses,
        tracks=replace(
            tracks,
            image_index=np.append(tracks.image_index[others], np.full(n_points, last)),
            point_index=np.append(tracks.point_index[others], seen),
            pixels=np.vstack(
                [tracks.pixels[others], pixels[seen] + rng.normal(size=(n_points, 2))]
            ),
        ),
    )


@pytest.mark.parametrize("n_points", [1, 2, 12])
@pytest.mark.parametrize("shared", [True, False], ids=["shared poses", "own poses"])
def test_it_changes_neither_the_noise_nor_x(n_points: int, shared: bool) -> None:
    """So few points leave its camera free: every robot pose agrees with it, and then it moves by degrees."""
    rng = np.random.default_rng(102)
    # Without another one at its robot pose; or of the camera with fewer images, which shares none.
    missing = frozenset({(0, N_POSES - 1) if shared else (1, 0)})
    scene = simulate_rig(rng, n_poses=N_POSES, n_points=120, start_sigma=1e-4, missing=missing)
    model = with_foreign(scene, n_points, rng)
    rig, reported = scene.rig, scene.robot_poses.base_T_gripper
    if not shared:
        reported = scene.scene.robot_poses.base_T_gripper
        rig = Rig(n_cameras=2, camera=rig.camera, pose=np.arange(len(rig.camera)))
    linear = rig_start(reported, model.world_T_camera, rig)
    assert np.flatnonzero(~linear.trusted).tolist() == [len(reported) - 1]
    start = start_state(model, model.cameras, linear, rig)
    found = refined_from(start, model, reported, trusted=linear.trusted)
    truth = scene.scene.noise
    assert found.noise.robot_rotation < 1.5 * truth.robot_rotation
    assert found.noise.robot_translation < 1.5 * truth.robot_translation
    error = frames.log(frames.inverse(found.state.gripper_T_camera) @ scene.gripper_T_cameras[0])
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.03
    assert np.linalg.norm(error[3:]) < 5e-4

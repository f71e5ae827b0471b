"""A second start reaches the same optimum, or finds the better one that the first start missed."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.graph import second_start as module
from handeye_fg.graph import start_state
from handeye_fg.options import NoiseOptions
from handeye_fg.priors import Prior
from handeye_fg.simulate import simulate_rig, simulate_scene
from handeye_fg.solvers import linear_start
from handeye_fg.solvers.rig import rig_start
from refinements import refined_from


def simulated(seed, **options):
    return simulate_scene(np.random.default_rng(seed), n_points=80, start_sigma=1e-4, **options)


def fit(scene, *, turn=(0.0, 0.0, 0.0), shift=(0.0, 0.0, 0.0), **how):
    reported = scene.robot_poses.base_T_gripper
    linear = linear_start(reported, scene.model.world_T_camera)
    start = start_state(scene.model, [scene.camera], linear)
    off = frames.exp(np.concatenate([turn, shift]))
    start = replace(start, gripper_T_cameras=start.gripper_T_cameras @ off)
    return refined_from(start, scene.model, reported, **how)


def distance(a, b):
    return frames.log(frames.inverse(a.state.gripper_T_camera) @ b.state.gripper_T_camera)


@pytest.mark.parametrize("motion", ["general", "one_axis", "pure_translation", "pure_rotation"])
@pytest.mark.parametrize("n_images", [4, 12])
def test_the_same_optimum_is_reached(motion, n_images):
    scene = simulated(n_images, n_images=n_images, motion=motion)
    second = fit(scene).second_start
    assert second.agrees
    assert not second.restarted


def test_what_is_known_of_x_is_part_of_the_optimum():
    scene = simulated(1, n_images=8, robot_translation_sigma=1e-3)
    axis = np.array([0.0, 0.6, 0.8])
    value = float(axis @ scene.gripper_T_camera[:3, 3]) + 2e-3
    prior = Prior(kind="translation-along", axis=tuple(axis), value=value, std=1e-4)
    result = fit(scene, priors=[prior])
    assert result.second_start.agrees
    assert axis @ result.state.gripper_T_camera[:3, 3] == pytest.approx(value, abs=5e-4)


@pytest.mark.parametrize(
    "off", [{"shift": (0.3, -0.2, 0.35)}, {"turn": (0.9, -0.6, 1.1)}], ids=["0.5 m", "88 deg"]
)
def test_a_start_that_leads_astray_is_mended(off):
    scene = simulated(0, n_images=8)
    right, far = fit(scene), fit(scene, **off)
    assert far.second_start.agrees
    assert far.second_start.restarted
    np.testing.assert_allclose(distance(right, far), 0.0, atol=1e-7)


def test_robot_poses_that_are_inverted():
    scene = simulated(3, n_images=8)
    assert fit(scene, inverted=True).second_start.agrees


def test_several_cameras_keep_their_places_on_the_arm():
    arm = simulate_rig(np.random.default_rng(4), n_poses=8, n_points=80, start_sigma=1e-4)
    reported, model = arm.robot_poses.base_T_gripper, arm.scene.model
    linear = rig_start(reported, model.world_T_camera, arm.rig)
    start = start_state(model, [arm.scene.camera] * 2, linear, arm.rig)
    aside = frames.pose(np.eye(3), np.array([0.4, -0.2, 0.4]))
    for first in (start, replace(start, gripper_T_cameras=aside @ start.gripper_T_cameras)):
        result = refined_from(first, model, reported)
        assert result.second_start.agrees
        assert result.second_start.restarted == (first is not start)
        np.testing.assert_allclose(result.state.gripper_T_cameras, arm.gripper_T_cameras, atol=1e-3)


def test_known_noise_levels():
    scene = simulated(0, n_images=8)
    noise = NoiseOptions(robot_rotation_deg=0.01, robot_translation_mm=0.05)
    second = fit(scene, noise=noise, shift=(0.3, -0.2, 0.35)).second_start
    assert second.agrees


def test_without_a_restart_the_wrong_optimum_is_told(monkeypatch):
    """The check itself, where its better start is not used."""
    monkeypatch.setattr(sys.modules["handeye_fg.graph.refine"], "_MOST_RESTARTS", 0)
    scene = simulated(0, n_images=8)
    result = fit(scene, shift=(0.3, -0.2, 0.35))
    assert not result.second_start.agrees
    assert result.second_start.translation > 0.1


def test_a_worse_optimum_elsewhere_is_told(monkeypatch):
    """A second start that ends elsewhere without being better, here for want of evaluations."""
    monkeypatch.setattr(module, "_MOST_EVALUATIONS", 2)
    second = fit(simulated(2, n_images=8)).second_start
    assert not second.agrees
    assert not second.restarted

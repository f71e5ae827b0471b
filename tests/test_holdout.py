"""Robot poses that are kept out of X, and how X predicts them."""

import json

import jsonschema
import numpy as np
import pytest
from scipy import stats

import handeye_fg as hf
from handeye_fg import frames
from handeye_fg.errors import InputDataError
from handeye_fg.graph.holdout import chosen
from handeye_fg.inputs import read_model_inputs
from handeye_fg.io.results import result_schema, to_document
from handeye_fg.pipeline import solve_scene
from handeye_fg.progress import Stopwatch, silent
from handeye_fg.scene import Scene
from handeye_fg.simulate import simulate_poses, simulate_scene

FIXED = hf.GraphOptions(intrinsics="fixed")


def calibrated(seed, holdout=0.25, spoil=None, n_images=16, **noise):
    scene = simulate_scene(
        np.random.default_rng(seed), n_images=n_images, n_points=60, start_sigma=1e-4, **noise
    )
    reported = dict(zip(scene.robot_poses.names, scene.robot_poses.base_T_gripper, strict=True))
    for name in spoil or ():
        reported[name] = reported[name] @ frames.exp([0.01, 0.0, 0.0, 0.0, 0.01, 0.0])
    options = hf.Options(graph=FIXED, holdout=holdout)
    inputs, model = read_model_inputs(scene.model, reported, options)
    return solve_scene(Scene(model=model), inputs, options, Stopwatch(), silent)


def test_held_out_poses_have_no_part_in_x():
    result = calibrated(1)
    held = [image.name for image in result.holdout.images]
    assert len(held) == 4
    # Wrong by 0.6 degrees and 10 mm, they change nothing but what is said of them.
    spoilt = calibrated(1, spoil=held)
    np.testing.assert_allclose(spoilt.matrix, result.matrix, atol=1e-7)
    np.testing.assert_allclose(spoilt.covariance, result.covariance, rtol=1e-3)
    assert result.holdout.probability > 1e-3
    assert spoilt.holdout.probability < 1e-6
    assert "as the uncertainty lets expect" in result.message
    assert f"{result.holdout.expected_reprojection:.2g} px are to be expected" in result.message
    assert "more than the uncertainty explains" in spoilt.message
    assert not any(image.outlier for image in spoilt.images)
    assert spoilt.holdout.reprojection_rms > 3.0 * result.holdout.reprojection_rms
    assert spoilt.holdout.expected_reprojection == pytest.approx(
        result.holdout.expected_reprojection, rel=0.01
    )
    assert spoilt.holdout.within < 0.5 < result.holdout.within
    reasons = {image.name: image.reason for image in result.images}
    assert all("kept out of X" in reasons[name] for name in held)
    assert sum(bool(reason) for reason in reasons.values()) == 4


def test_there_and_back(tmp_path):
    result = calibrated(2)
    document = to_document(result)
    jsonschema.Draft202012Validator(result_schema()).validate(document)
    result.save(tmp_path)
    again = hf.load_result(tmp_path).holdout
    assert json.dumps(to_document(hf.load_result(tmp_path))["holdout"])
    assert [one.name for one in again.images] == [one.name for one in result.holdout.images]
    assert again.rotation == pytest.approx(result.holdout.rotation)
    assert again.expected_translation == pytest.approx(result.holdout.expected_translation)
    assert again.expected_reprojection == pytest.approx(result.holdout.expected_reprojection)
    assert again.within == result.holdout.within
    assert calibrated(2, holdout=0.0).holdout is None


def test_camera_poses_alone_have_nothing_to_hold_out():
    robot, camera, _ = simulate_poses(np.random.default_rng(0), n_poses=8)
    names = [f"{i}.png" for i in range(8)]
    poses = [dict(zip(names, matrices, strict=True)) for matrices in (camera, robot)]
    with pytest.raises(InputDataError, match="camera poses without points"):
        hf.refine(*poses, hf.Options(holdout=0.25))
    with pytest.raises(InputDataError, match="camera poses without points"):
        hf.refine(*poses, holdout=("new", {}))


def test_held_out_poses_are_spread():
    rng = np.random.default_rng(0)
    line = np.tile(np.eye(4), (20, 1, 1))
    line[:, 0, 3] = rng.permutation(20)
    held = chosen(line, 0.25, 3)
    assert held.sum() == 5
    assert np.diff(np.sort(line[held, 0, 3])).max() <= 8.0
    np.testing.assert_array_equal(held, chosen(line, 0.25, 3))
    with pytest.raises(InputDataError, match="must be left"):
        chosen(line[:5], 0.5, 0)
    with pytest.raises(ValueError, match=r"between 0 and 0\.5"):
        hf.Options(holdout=0.8)


@pytest.mark.slow
@pytest.mark.simulation
@pytest.mark.parametrize("arm", [0.1, 0.01])
def test_errors_are_as_large_as_expected(arm):
    """The probability is uniform, and the errors' mean squares are those expected.

    For a noisy arm, and for one whose noise moves points no more than that of the features does.
    """
    found = [
        calibrated(
            seed, robot_rotation_sigma=np.deg2rad(arm), robot_translation_sigma=1e-2 * arm
        ).holdout
        for seed in range(30)
    ]
    assert stats.kstest([one.probability for one in found], "uniform").pvalue > 1e-3
    # 30 runs of 12 components: standard error of a root mean square 4 %.
    for name in ("rotation", "translation"):
        squares = [(getattr(one, name) / getattr(one, f"expected_{name}")) ** 2 for one in found]
        assert 0.8 < np.sqrt(np.mean(squares)) < 1.2
    # Points of an image move together: no more than the 24 components of four poses are independent.
    pixels = [(one.reprojection_rms / one.expected_reprojection) ** 2 for one in found]
    assert 0.85 < np.sqrt(np.mean(pixels)) < 1.15
    assert 0.92 < np.mean([one.within for one in found]) < 0.98
